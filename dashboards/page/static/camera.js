// What part of the map is in view, and how mouse, touch and keyboard change it.

const [SCALE_MIN, SCALE_MAX] = [0.5, 1000];
const KEY_STEP_PX = 60;

/** Looks at (x, y) metres of the map with `scale` pixels for each metre. `changed` is called after every change. */
export class Camera {
  constructor(canvas, changed) {
    [this.x, this.y, this.scale] = [0, 0, 40];
    this.canvas = canvas;
    this.changed = changed;
    /** The whole map stays in view until somebody moves it. */
    this.fits = true;
    this.follows = false;
    this.pointers = new Map();
    this.listen();
  }

  get width() {
    return this.canvas.clientWidth;
  }

  get height() {
    return this.canvas.clientHeight;
  }

  /** From metres of the map to pixels: for setTransform. */
  matrix() {
    const { scale, width, height } = this;
    return [scale, 0, 0, -scale, width / 2 - this.x * scale, height / 2 + this.y * scale];
  }

  /** The part of the map in view, metres. */
  box() {
    const [w, h] = [this.width / 2 / this.scale, this.height / 2 / this.scale];
    return { left: this.x - w, right: this.x + w, bottom: this.y - h, top: this.y + h };
  }

  show(box) {
    if (!box || !this.width || !this.height) return;
    [this.x, this.y] = [(box.left + box.right) / 2, (box.bottom + box.top) / 2];
    const scale = Math.min(this.width / (box.right - box.left + 1), this.height / (box.top - box.bottom + 1));
    this.scale = clamp(scale * 0.94);
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.moved();
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const before = this.scale;
    this.scale = clamp(this.scale * factor);
    const kept = 1 / before - 1 / this.scale;
    if (!this.follows) {
      this.x += (px - this.width / 2) * kept;
      this.y -= (py - this.height / 2) * kept;
    }
    this.fits = false;
    this.changed();
  }

  moved() {
    [this.fits, this.follows] = [false, false];
    this.changed();
  }

  fit() {
    [this.fits, this.follows] = [true, false];
    this.changed();
  }

  follow() {
    this.follows = !this.follows;
    if (this.follows) {
      if (this.fits) this.scale = clamp(Math.max(this.scale, 40));
      this.fits = false;
    }
    this.changed();
  }

  listen() {
    const { canvas } = this;
    canvas.addEventListener('wheel', (event) => {
      event.preventDefault();
      const lines = event.deltaMode === 1 ? 16 : 1;
      this.zoom(Math.exp(-event.deltaY * lines * (event.ctrlKey ? 0.01 : 0.0016)), event.offsetX, event.offsetY);
    }, { passive: false });
    canvas.addEventListener('pointerdown', (event) => {
      canvas.setPointerCapture(event.pointerId);
      canvas.classList.add('held');
      this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    canvas.addEventListener('pointermove', (event) => this.drag(event));
    for (const kind of ['pointerup', 'pointercancel']) {
      canvas.addEventListener(kind, (event) => {
        this.pointers.delete(event.pointerId);
        canvas.classList.toggle('held', this.pointers.size > 0);
      });
    }
    canvas.addEventListener('dblclick', (event) => this.zoom(2, event.offsetX, event.offsetY));
    canvas.addEventListener('keydown', (event) => this.key(event));
  }

  /** One finger moves, two fingers move and zoom. */
  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.offsetX, event.offsetY];
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)?.[1];
    this.pointers.set(event.pointerId, now);
    const share = other ? 0.5 : 1;
    const [dx, dy] = [(now[0] - before[0]) * share, (now[1] - before[1]) * share];
    if (dx || dy) this.pan(dx, dy);
    if (other) {
      const gap = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      if (gap(before) > 8 && gap(now) > 8) {
        this.zoom(gap(now) / gap(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      }
    }
  }

  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = KEY_STEP_PX * (event.shiftKey ? 4 : 1);
    const keys = {
      ArrowLeft: () => this.pan(step, 0),
      ArrowRight: () => this.pan(-step, 0),
      ArrowUp: () => this.pan(0, step),
      ArrowDown: () => this.pan(0, -step),
      '+': () => this.zoom(1.3),
      '=': () => this.zoom(1.3),
      '-': () => this.zoom(1 / 1.3),
      Home: () => this.fit(),
    };
    if (keys[event.key]) {
      event.preventDefault();
      keys[event.key]();
    }
  }
}

function clamp(scale) {
  return Math.min(SCALE_MAX, Math.max(SCALE_MIN, scale));
}
