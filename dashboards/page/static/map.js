// The map, and everything that is drawn over it.

import { Camera } from './camera.js';
import { Tiles, shades } from './tiles.js';

const IDENTITY = [0, 0, 0];
const SCAN_UNIT_M = 0.005;
// Of other robots.
const [TRAIL_EVERY_M, TRAIL_MAX, SILENT_MS] = [0.1, 4000, 3000];

export class MapView {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext('2d', { alpha: false });
    this.layers = { path: true, scan: true, submaps: false, closures: true, tracks: true, flock: true };
    this.map = new Tiles();
    this.live = new Tiles();
    this.cellSize = 0.05;
    this.afterDraw = [];
    this.camera = new Camera(canvas, () => this.redraw());
    this.clear();
    this.readColours();
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.readColours());
    new ResizeObserver(() => this.redraw()).observe(canvas);
    // A page that is hidden is not asked to draw any more.
    document.addEventListener('visibilitychange', () => this.drawPending());
  }

  /** Drops everything: it will be sent again. */
  clear() {
    this.map.clear();
    this.live.clear();
    this.path = new Path();
    this.placed = new Map();
    this.origins = [];
    this.closures = [];
    this.tracks = [];
    this.otherRobots = new Map();
    this.robot = null;
    this.scan = null;
  }

  take(json, sections) {
    if (json.hello) {
      this.clear();
      this.cellSize = json.hello.head.cell_size_m;
    }
    if (json.robot !== undefined) this.robot = json.robot;
    if (json.tracks !== undefined) this.tracks = json.tracks ?? [];
    if (json.other_robots) this.showRobots(json.other_robots);
    if (json.graph) {
      this.placed = new Map(json.graph.submaps);
      this.origins = json.graph.origins;
      this.closures = json.graph.closures;
    }
    for (const { kind, data } of sections) {
      if (kind === 1) this.map.take(data);
      else if (kind === 2) this.live.take(data);
      else if (kind === 3) this.path.take(data);
      else if (kind === 4) this.scan = readScan(data);
    }
    this.redraw();
  }

  /** Draws soon; `then` is called when it is done. Nothing is drawn while the page is not to be seen. */
  redraw(then) {
    if (then) this.afterDraw.push(then);
    if (this.pending) return;
    this.pending = true;
    if (document.hidden) setTimeout(() => this.drawPending(), 0);
    else requestAnimationFrame(() => this.drawPending());
  }

  drawPending() {
    if (!this.pending) return;
    this.pending = false;
    if (!document.hidden) this.draw();
    for (const after of this.afterDraw.splice(0)) after();
  }

  readColours() {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    this.colours = Object.fromEntries(
      ['map-unknown', 'map-free', 'map-occupied', 'path', 'scan', 'submap', 'loop', 'track', 'flock', 'warn', 'bad', 'ink', 'line', 'sheet', 'accent'].map((name) => [name, colour(name)]),
    );
    this.shades = shades(numbers(this.colours['map-free']), numbers(this.colours['map-occupied']));
    this.map.dropColours();
    this.live.dropColours();
    this.redraw();
  }

  /** Where a submap's odom is in the map. One that is not placed is where the newest correction has it. */
  place(submap) {
    return this.placed.get(submap) ?? this.robot?.map_from_odom ?? IDENTITY;
  }

  bounds() {
    const [map, live] = [this.map.bounds(), this.live.bounds()];
    const size = this.cellSize;
    const corners = [];
    const add = (box, pose) => {
      if (!box) return;
      for (const x of [box.left, box.right]) for (const y of [box.bottom, box.top]) corners.push(apply(pose, x * size, y * size));
    };
    add(map, IDENTITY);
    add(live, this.robot?.map_from_odom ?? IDENTITY);
    if (!corners.length) return null;
    const [xs, ys] = [corners.map((c) => c[0]), corners.map((c) => c[1])];
    return { left: Math.min(...xs), right: Math.max(...xs), bottom: Math.min(...ys), top: Math.max(...ys) };
  }

  draw() {
    const { canvas, context, camera, colours } = this;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [Math.round(camera.width * ratio), Math.round(camera.height * ratio)];
    if (!width || !height) return;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    if (camera.fits) camera.show(this.bounds());
    if (camera.follows && this.robot) [camera.x, camera.y] = this.robot.map_from_base;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.fillStyle = colours['map-unknown'];
    context.fillRect(0, 0, width, height);
    this.base = new DOMMatrix([ratio, 0, 0, ratio, 0, 0]).multiply(new DOMMatrix(camera.matrix()));
    this.drawTiles(this.map, IDENTITY);
    this.drawTiles(this.live, this.robot?.map_from_odom ?? IDENTITY);
    if (this.layers.submaps) this.drawSubmaps();
    if (this.layers.closures) this.drawClosures();
    if (this.layers.path) this.drawPath();
    if (this.layers.scan && this.scan) this.drawScan();
    if (this.layers.tracks) this.drawTracks();
    if (this.layers.flock) this.drawFlock();
    if (this.robot) this.drawRobot();
    this.onDrawn?.();
  }

  /** From here on coordinates are metres in the frame at this pose. */
  enter([x, y, heading]) {
    const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
    this.context.setTransform(this.base.multiply(new DOMMatrix([cos, sin, -sin, cos, x, y])));
  }

  drawTiles(tiles, pose) {
    const { context, cellSize, camera } = this;
    this.enter(pose);
    context.scale(cellSize, cellSize);
    const [view, back] = [camera.box(), inverse(pose)];
    const corners = [];
    for (const x of [view.left, view.right]) for (const y of [view.bottom, view.top]) corners.push(apply(back, x, y));
    const range = (i) => corners.map((corner) => corner[i] / cellSize);
    const box = { left: Math.min(...range(0)), right: Math.max(...range(0)), bottom: Math.min(...range(1)), top: Math.max(...range(1)) };
    tiles.draw(context, box, cellSize * this.base.a, this.shades);
  }

  drawPath() {
    const { context, colours, camera } = this;
    context.lineJoin = 'round';
    context.lineCap = 'round';
    for (const piece of this.path.pieces) {
      this.enter(this.place(piece.submap));
      context.lineWidth = 2.2 / camera.scale;
      context.strokeStyle = piece.good ? colours.path : colours.warn;
      context.stroke(piece.line);
    }
  }

  drawScan() {
    const { context, colours, camera } = this;
    this.enter(this.scan.pose);
    const size = Math.max(2.4 / camera.scale, 0.03);
    context.fillStyle = colours.scan;
    const { points } = this.scan;
    for (let i = 0; i < points.length; i += 2) {
      context.fillRect(points[i] * SCAN_UNIT_M - size / 2, points[i + 1] * SCAN_UNIT_M - size / 2, size, size);
    }
  }

  drawSubmaps() {
    const { context, colours, camera } = this;
    const side = 9 / camera.scale;
    for (const [number, origin] of this.origins) {
      if (!this.placed.has(number)) continue;
      const [x, y] = apply(this.place(number), origin[0], origin[1]);
      this.enter([x, y, 0]);
      context.fillStyle = colours.submap;
      context.strokeStyle = colours['map-unknown'];
      context.lineWidth = 1.5 / camera.scale;
      context.beginPath();
      context.rect(-side / 2, -side / 2, side, side);
      context.fill();
      context.stroke();
      if (camera.scale > 14) {
        context.scale(1 / camera.scale, -1 / camera.scale);
        context.font = '11px system-ui, sans-serif';
        context.fillText(number, 8, 4);
      }
    }
  }

  drawClosures() {
    const { context, colours, camera } = this;
    this.enter(IDENTITY);
    context.strokeStyle = colours.loop;
    context.lineWidth = 1.1 / camera.scale;
    // There may be thousands: all that act in one stroke, then those that were revoked, dashed.
    for (const wanted of [1, 0]) {
      context.globalAlpha = wanted ? 0.5 : 0.3;
      context.setLineDash(wanted ? [] : [4 / camera.scale, 4 / camera.scale]);
      context.beginPath();
      for (const [x1, y1, x2, y2, acts] of this.closures) {
        if (acts !== wanted) continue;
        context.moveTo(x1, y1);
        context.lineTo(x2, y2);
      }
      context.stroke();
    }
    context.setLineDash([]);
    context.globalAlpha = 1;
  }

  /** What moves: a ring, and an arrow to where it will be in a second. */
  drawTracks() {
    const { context, colours, camera } = this;
    this.enter(this.robot?.map_from_odom ?? IDENTITY);
    context.strokeStyle = colours.track;
    context.lineWidth = 2 / camera.scale;
    for (const { at: [x, y], velocity: [vx, vy], radius_m: radius } of this.tracks) {
      context.beginPath();
      context.arc(x, y, Math.max(radius, 5 / camera.scale), 0, 7);
      context.moveTo(x, y);
      context.lineTo(x + vx, y + vy);
      if (Math.hypot(vx, vy) > 0.05) {
        const [heading, tip] = [Math.atan2(vy, vx), 7 / camera.scale];
        for (const side of [2.6, -2.6]) {
          context.moveTo(x + vx, y + vy);
          context.lineTo(x + vx + tip * Math.cos(heading + side), y + vy + tip * Math.sin(heading + side));
        }
      }
      context.stroke();
    }
  }

  /** Other robots: where they are, and where they were since the page was opened. */
  showRobots(otherRobots) {
    for (const { name, map_from_base: pose, age_s: age } of otherRobots) {
      const known = this.otherRobots.get(name) ?? { trail: [] };
      const last = known.trail.at(-1);
      if (!last || Math.hypot(last[0] - pose[0], last[1] - pose[1]) > TRAIL_EVERY_M) known.trail.push(pose);
      if (known.trail.length > TRAIL_MAX) known.trail.shift();
      this.otherRobots.set(name, { ...known, pose, received: performance.now() - age * 1000 });
    }
  }

  drawFlock() {
    const { context, colours, camera } = this;
    for (const [name, { pose, trail, received }] of this.otherRobots) {
      const silent = performance.now() - received > SILENT_MS;
      this.enter(IDENTITY);
      context.globalAlpha = silent ? 0.45 : 1;
      context.strokeStyle = colours.flock;
      context.lineWidth = 1.6 / camera.scale;
      context.beginPath();
      trail.forEach(([x, y], i) => (i && Math.hypot(x - trail[i - 1][0], y - trail[i - 1][1]) < 2 ? context.lineTo(x, y) : context.moveTo(x, y)));
      context.stroke();
      this.enter(pose);
      this.drawArrow(colours.flock);
      this.enter([pose[0], pose[1], 0]);
      context.scale(1 / camera.scale, -1 / camera.scale);
      context.font = '600 12px system-ui, sans-serif';
      context.lineWidth = 3;
      context.strokeStyle = colours.sheet;
      context.fillStyle = colours.flock;
      context.strokeText(name, 13, -9);
      context.fillText(name, 13, -9);
      context.globalAlpha = 1;
    }
  }

  drawRobot() {
    const { context, colours, camera, robot } = this;
    this.enter(robot.map_from_base);
    const good = robot.quality === 'tracking';
    const colour = good ? colours.accent : robot.quality === 'degraded' ? colours.warn : colours.bad;
    if (robot.sigma_m * 2 * camera.scale > 4) {
      context.globalAlpha = 0.2;
      context.fillStyle = colour;
      context.beginPath();
      context.arc(0, 0, Math.min(robot.sigma_m * 2, 5), 0, 7);
      context.fill();
      context.globalAlpha = 1;
    }
    this.drawArrow(colour);
  }

  /** The mark of a robot, at the pose that was entered. */
  drawArrow(colour) {
    const { context, colours, camera } = this;
    const size = Math.max(0.28, 11 / camera.scale);
    context.beginPath();
    context.moveTo(size, 0);
    context.lineTo(-size * 0.75, size * 0.72);
    context.lineTo(-size * 0.4, 0);
    context.lineTo(-size * 0.75, -size * 0.72);
    context.closePath();
    context.fillStyle = colour;
    context.strokeStyle = colours.sheet;
    context.lineWidth = 4 / camera.scale;
    context.lineJoin = 'round';
    context.stroke();
    context.fill();
  }
}

/** The way driven, in pieces that are drawn at once: one submap and one quality each. */
class Path {
  constructor() {
    this.pieces = [];
    this.count = 0;
    this.last = null;
  }

  take(data) {
    const first = data.getUint32(0, true);
    for (let at = 4, index = first; at < data.byteLength; at += 16, index++) {
      // What is known already may come again.
      if (index < this.count) continue;
      this.add(data.getUint32(at, true), data.getFloat32(at + 4, true), data.getFloat32(at + 8, true), data.getUint32(at + 12, true) === 0);
      this.count += 1;
    }
  }

  add(submap, x, y, good) {
    let piece = this.pieces.at(-1);
    if (!piece || piece.submap !== submap || piece.good !== good) {
      const begin = this.last && Math.hypot(this.last[0] - x, this.last[1] - y) < 2 ? this.last : [x, y];
      piece = { submap, good, line: new Path2D() };
      piece.line.moveTo(...begin);
      this.pieces.push(piece);
    }
    piece.line.lineTo(x, y);
    this.last = [x, y];
  }
}

function readScan(data) {
  const pose = [0, 8, 16].map((at) => data.getFloat64(at, true));
  const points = new Int16Array((data.byteLength - 24) / 2);
  for (let i = 0; i < points.length; i++) points[i] = data.getInt16(24 + 2 * i, true);
  return { pose, points };
}

/** A point of the frame at a pose, in the frame around it. */
function apply([x, y, heading], px, py) {
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  return [x + cos * px - sin * py, y + sin * px + cos * py];
}

function inverse([x, y, heading]) {
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  return [-cos * x - sin * y, sin * x - cos * y, -heading];
}

function numbers(colour) {
  const digits = colour.replace('#', '');
  return [0, 2, 4].map((at) => parseInt(digits.slice(at, at + 2), 16));
}
