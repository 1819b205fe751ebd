// A lattice of cells as cached pictures.
//
// Tiles of 64 x 64 cells are gathered in chunks of 8 x 8. Each chunk has pictures in several resolutions, in which the darkest cell
// of a block wins: walls are one or two cells wide and would fade away when the whole building is in view.

const TILE = 64;
const CHUNK_TILES = 8;
const CHUNK = TILE * CHUNK_TILES;
const LEVELS = 5;

/** Colours of the shades 0 (unknown) to 15 (occupied), as numbers for a canvas. */
export function shades(free, occupied) {
  const table = new Uint32Array(16);
  for (let shade = 1; shade < 16; shade++) {
    const part = ((shade - 1) / 14) ** 1.2;
    const [r, g, b] = free.map((from, i) => Math.round(from + part * (occupied[i] - from)));
    table[shade] = (255 << 24) | (b << 16) | (g << 8) | r;
  }
  return table;
}

class Chunk {
  constructor(x, y) {
    [this.x, this.y] = [x, y];
    this.cells = new Uint8Array(CHUNK * CHUNK);
    this.levels = [];
    this.known = 0;
  }

  /** The picture of a level, with all that has changed since. */
  picture(level, colours) {
    const side = CHUNK >> level;
    let own = this.levels[level];
    if (!own) {
      const canvas = new OffscreenCanvas(side, side);
      own = { canvas, context: canvas.getContext('2d'), stale: new Set(Array(64).keys()) };
      this.levels[level] = own;
    }
    for (const tile of own.stale) this.paint(own.context, tile, level, colours);
    own.stale.clear();
    return own.canvas;
  }

  paint(context, tile, level, colours) {
    const [left, bottom] = [(tile % CHUNK_TILES) * TILE, Math.floor(tile / CHUNK_TILES) * TILE];
    const [side, step] = [TILE >> level, 1 << level];
    const image = new ImageData(side, side);
    const pixels = new Uint32Array(image.data.buffer);
    for (let y = 0; y < side; y++) {
      for (let x = 0; x < side; x++) {
        let darkest = 0;
        for (let v = 0; v < step; v++) {
          const row = (bottom + y * step + v) * CHUNK + left + x * step;
          for (let u = 0; u < step; u++) darkest = Math.max(darkest, this.cells[row + u]);
        }
        pixels[y * side + x] = colours[darkest];
      }
    }
    context.putImageData(image, left >> level, bottom >> level);
  }

  touch(tile) {
    for (const level of this.levels) level?.stale.add(tile);
  }

  dropColours() {
    for (const level of this.levels) if (level) for (let tile = 0; tile < 64; tile++) level.stale.add(tile);
  }
}

/** All tiles of one lattice. */
export class Tiles {
  constructor() {
    this.clear();
  }

  clear() {
    this.chunks = new Map();
    this.tiles = new Set();
    this.box = null;
  }

  /** Takes in a section of tiles. */
  take(data) {
    for (let at = 0; at < data.byteLength; ) {
      const [x, y, length] = [data.getInt32(at, true), data.getInt32(at + 4, true), data.getUint16(at + 8, true)];
      this.set(x, y, new Uint8Array(data.buffer, data.byteOffset + at + 10, length));
      at += 10 + length;
    }
  }

  set(x, y, code) {
    const [column, row] = [Math.floor(x / CHUNK_TILES), Math.floor(y / CHUNK_TILES)];
    const key = `${column},${row}`;
    let chunk = this.chunks.get(key);
    if (!chunk) this.chunks.set(key, (chunk = new Chunk(column, row)));
    const [left, bottom] = [x - column * CHUNK_TILES, y - row * CHUNK_TILES];
    const start = bottom * TILE * CHUNK + left * TILE;
    const put = (from, to, shade) => {
      // A run may go over several rows of the tile.
      for (let cell = from; cell < to; ) {
        const rest = Math.min(to - cell, TILE - (cell % TILE));
        const place = start + Math.floor(cell / TILE) * CHUNK + (cell % TILE);
        chunk.cells.fill(shade, place, place + rest);
        cell += rest;
      }
    };
    let cell = 0;
    for (let at = 0; at < code.length; ) {
      const shade = code[at] >> 4;
      let run = code[at] & 15;
      at += 1;
      if (run === 0) {
        run = (code[at] | (code[at + 1] << 8)) + 1;
        at += 2;
      }
      put(cell, cell + run, shade);
      cell += run;
    }
    const count = this.tiles.size;
    if (code.length === 0) {
      put(0, TILE * TILE, 0);
      this.tiles.delete(`${x},${y}`);
    } else {
      this.tiles.add(`${x},${y}`);
    }
    if (this.tiles.size !== count) this.box = null;
    chunk.touch(bottom * CHUNK_TILES + left);
  }

  /** Draws what is in `box` (cells). The context is scaled to cells, y upwards; `pixels` are there for each cell. */
  draw(context, box, pixels, colours) {
    const level = Math.max(0, Math.min(LEVELS - 1, Math.floor(Math.log2(1 / pixels) + 0.3)));
    context.imageSmoothingEnabled = pixels < 2;
    context.imageSmoothingQuality = 'medium';
    const seam = 0.4 / pixels;
    for (const chunk of this.chunks.values()) {
      const [x, y] = [chunk.x * CHUNK, chunk.y * CHUNK];
      if (x > box.right || y > box.top || x + CHUNK < box.left || y + CHUNK < box.bottom) continue;
      context.drawImage(chunk.picture(level, colours), x, y, CHUNK + seam, CHUNK + seam);
    }
  }

  dropColours() {
    for (const chunk of this.chunks.values()) chunk.dropColours();
  }

  /** The cells that have tiles. */
  bounds() {
    if (this.box || !this.tiles.size) return this.box;
    const box = { left: Infinity, bottom: Infinity, right: -Infinity, top: -Infinity };
    for (const tile of this.tiles) {
      const [x, y] = tile.split(',').map(Number);
      box.left = Math.min(box.left, x * TILE);
      box.bottom = Math.min(box.bottom, y * TILE);
      box.right = Math.max(box.right, (x + 1) * TILE);
      box.top = Math.max(box.top, (y + 1) * TILE);
    }
    return (this.box = box);
  }
}
