// Stages, their latencies over time, and what has happened.

export const STAGES = ['lidar-ingest', 'correlation-filter', 'scan-matcher', 'mapper', 'dynamic-cleaner', 'sync-manager'];
const HUES = {
  dark: ['#7aa7ff', '#c792ea', '#35c4b5', '#f0b13c', '#ff8a5c', '#8fd460'],
  light: ['#2d5fd0', '#8a3fc4', '#0b7f78', '#a86a00', '#cc4a12', '#4b8a16'],
};
const SPAN_MS = 300_000;
const EVENTS_SHOWN = 60;
const STRUCK_MS = 15_000;
const [TOP_MS, BOTTOM_MS] = [1000, 0.01];

export class Panel {
  constructor(onRestart) {
    this.onRestart = onRestart;
    this.dark = matchMedia('(prefers-color-scheme: dark)');
    this.dark.addEventListener('change', () => this.draw());
    this.list = document.querySelector('#stages');
    this.time = document.querySelector('#time');
    this.events = document.querySelector('#events');
    this.cards = new Map();
    this.clear();
    new ResizeObserver(() => this.draw()).observe(this.time);
    setInterval(() => this.tick(), 500);
  }

  clear() {
    this.samples = [];
    this.happened = [];
    this.struck = new Map();
    this.offset = 0;
    this.health = null;
    this.events.replaceChildren(element('li', 'none', 'Nothing has happened yet.'));
  }

  get now() {
    return performance.now() + this.offset;
  }

  take(json) {
    if (json.hello) {
      this.clear();
      this.mayOrder = json.hello.controls !== 'off';
    }
    this.offset = json.now_ms - performance.now();
    if (json.latencies) this.samples.push(...json.latencies);
    while (this.samples.length && this.samples[0].at_ms < this.now - SPAN_MS - 5000) this.samples.shift();
    for (const event of json.events ?? []) this.happen(event);
    if (json.health !== undefined) {
      this.health = json.health;
      this.showStages();
      this.showUnattached(json.health?.unattached);
      this.showFlock(json.health?.flock);
    }
    if (json.latencies || json.events) this.tick();
  }

  happen(event) {
    this.happened.push(event);
    if (event.stage && event.kind !== 'order') this.struck.set(event.stage, event.at_ms);
    this.events.querySelector('.none')?.remove();
    const item = element('li', event.kind);
    const time = element('time', '', new Date(Date.now() - (this.now - event.at_ms)).toLocaleTimeString([], { hour12: false }));
    item.append(time, element('span', '', event.text));
    this.events.prepend(item);
    while (this.events.children.length > EVENTS_SHOWN) this.events.lastChild.remove();
  }

  showStages() {
    const stages = this.health?.stages ?? [];
    const key = (stage) => `${stage.stage} ${stage.replica}`;
    const order = (stage) => STAGES.indexOf(stage.stage) * 100 + stage.replica;
    const sorted = [...stages].sort((a, b) => order(a) - order(b));
    const present = new Set(sorted.map(key));
    for (const [name, card] of this.cards) {
      if (present.has(name) || !stages.length) continue;
      card.item.remove();
      this.cards.delete(name);
    }
    sorted.forEach((stage, index) => {
      let card = this.cards.get(key(stage));
      if (!card) this.cards.set(key(stage), (card = this.card(stage)));
      if (this.list.children[index] !== card.item) this.list.insertBefore(card.item, this.list.children[index] ?? null);
      card.stage = stage;
      card.item.dataset.state = stage.state;
      set(card.restarts, `${stage.restarts} ${stage.restarts === 1 ? 'restart' : 'restarts'}`);
      card.restarts.classList.toggle('some', stage.restarts > 0);
      card.again.hidden = !this.mayOrder;
    });
    const uptime = this.health ? `up ${span(this.health.uptime_s)}` : 'the supervisor does not answer';
    set(document.querySelector('#uptime'), uptime);
    this.tick();
  }

  /** What nothing connects with the map. */
  showUnattached(part) {
    const line = document.querySelector('#unattached');
    line.hidden = !part;
    if (part) set(line, `Not in the map: ${part.scans} scans, ${part.travel_m.toFixed(0)} m, the first ${span(part.since_s)} after the start`);
  }

  /** Every robot that is known of: whether it is in the common map, and whether it is near. */
  showFlock(flock) {
    const section = document.querySelector('#flock');
    section.hidden = !flock;
    if (!flock) return;
    const state = flock.problem ?? (flock.merged ? `one map of ${flock.members.length} robots` : 'a map of its own');
    set(document.querySelector('#flock-state'), state);
    const named = (addresses, name) => addresses.some((address) => address.slice(0, address.lastIndexOf('-')) === name);
    const rows = [...new Set(flock.robots)].map((name) => {
      const place = flock.merged && flock.members.includes(name) ? 'in the map' : 'not placed';
      const reach = name === flock.robot ? 'this robot' : named(flock.near, name) ? 'near' : named(flock.peers, name) ? 'connected' : 'out of reach';
      const row = element('li', 'robot');
      row.dataset.robot = name;
      row.dataset.reach = reach;
      row.append(element('i', 'dot'), element('span', 'name', name), element('span', 'detail', `${place}, ${reach}`));
      return row;
    });
    document.querySelector('#robots').replaceChildren(...rows);
    const size = (bytes) => (bytes < 1e6 ? `${(bytes / 1e3).toFixed(1)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);
    set(document.querySelector('#flock-traffic'), `${flock.records[0]} records, ${size(flock.records[1])}; received ${size(flock.received_bytes)}, sent ${size(flock.said_bytes)}`);
  }

  card(stage) {
    const item = element('li', 'stage');
    item.dataset.stage = stage.stage;
    const name = stage.replica ? `${stage.stage} ${stage.replica}` : stage.stage;
    const [restarts, detail, again] = [element('span', 'restarts'), element('span', 'detail'), element('button', 'again', '↻')];
    again.title = `Restart ${stage.stage}`;
    again.setAttribute('aria-label', again.title);
    again.addEventListener('click', () => this.askToRestart(again, stage.stage));
    item.append(element('i', 'dot'), element('span', 'name', name), restarts, again, detail);
    return { item, restarts, detail, again };
  }

  /** A restart takes two clicks. */
  askToRestart(button, stage) {
    const calm = () => {
      button.classList.remove('asks');
      button.textContent = '↻';
      button.setAttribute('aria-label', `Restart ${stage}`);
    };
    if (button.classList.contains('asks')) {
      calm();
      this.onRestart(stage);
      return;
    }
    button.classList.add('asks');
    button.textContent = 'Sure?';
    button.setAttribute('aria-label', `Really restart ${stage}?`);
    setTimeout(calm, 4000);
  }

  /** What changes with time alone. */
  tick() {
    const hues = this.hues();
    const newest = this.newest();
    for (const { item, detail, stage } of this.cards.values()) {
      const hit = this.now - (this.struck.get(stage.stage) ?? -Infinity);
      const isStruck = hit < STRUCK_MS;
      item.classList.toggle('struck', isStruck);
      const hue = hues[STAGES.indexOf(stage.stage)];
      if (item.style.getPropertyValue('--hue') !== hue) item.style.setProperty('--hue', hue);
      const latency = newest?.stages[stage.stage];
      const figures = latency ? `${duration(latency.p50_ms)} · p99 ${duration(latency.p99_ms)} · ${latency.rate_hz.toFixed(1)} Hz` : 'idle';
      const words = isStruck ? `replaced ${Math.max(0, Math.round(hit / 1000))} s ago` : stage.state === 'running' ? figures : stage.state;
      set(detail, words);
    }
    const matcher = newest?.stages['scan-matcher'];
    set(document.querySelector('#scan-to-pose'), matcher ? `${duration(matcher.since_scan_p50_ms)}, p99 ${duration(matcher.since_scan_p99_ms)}` : '–');
    this.draw();
  }

  newest() {
    const sample = this.samples.at(-1);
    return sample && this.now - sample.at_ms < 5000 ? sample : null;
  }

  hues() {
    return this.dark.matches ? HUES.dark : HUES.light;
  }

  /** The time line: a curve for each stage, and a mark for each thing that happened. */
  draw() {
    const canvas = this.time;
    const ratio = Math.min(devicePixelRatio || 1, 2);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    if (!width || document.hidden) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      Object.assign(canvas, { width: Math.round(width * ratio), height: Math.round(height * ratio) });
    }
    const context = canvas.getContext('2d');
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(`--${name}`).trim();
    const [left, bottom] = [46, height - 18];
    const x = (ms) => left + (1 + (ms - this.now) / SPAN_MS) * (width - left - 8);
    const y = (ms) => 8 + (Math.log(TOP_MS / Math.max(ms, BOTTOM_MS)) / Math.log(TOP_MS / BOTTOM_MS)) * (bottom - 8);
    context.font = '10.5px system-ui, sans-serif';
    context.lineWidth = 1;
    context.textAlign = 'right';
    context.textBaseline = 'middle';
    for (const [ms, label] of [[0.01, '10 µs'], [0.1, '100 µs'], [1, '1 ms'], [10, '10 ms'], [100, '100 ms'], [1000, '1 s']]) {
      context.strokeStyle = colour('line');
      context.beginPath();
      context.moveTo(left, y(ms));
      context.lineTo(width - 8, y(ms));
      context.stroke();
      context.fillStyle = colour('soft');
      context.fillText(label, left - 5, y(ms));
    }
    context.textBaseline = 'alphabetic';
    for (const minutes of [4, 3, 2, 1, 0]) {
      context.textAlign = minutes === 0 ? 'right' : 'center';
      context.fillText(minutes ? `−${minutes} min` : 'now', x(this.now - minutes * 60_000), height - 5);
    }
    this.drawMarks(context, x, bottom, colour);
    this.drawCurves(context, x, y);
    this.describe();
  }

  drawMarks(context, x, bottom, colour) {
    for (const { at_ms, kind } of this.happened) {
      if (at_ms < this.now - SPAN_MS || kind === 'closure') continue;
      const hue = kind === 'order' ? colour('soft') : colour('bad');
      const at = x(at_ms);
      context.strokeStyle = context.fillStyle = hue;
      context.globalAlpha = 0.7;
      context.beginPath();
      context.moveTo(at, 8);
      context.lineTo(at, bottom);
      context.stroke();
      context.globalAlpha = 1;
      context.beginPath();
      context.moveTo(at - 4.5, 2);
      context.lineTo(at + 4.5, 2);
      context.lineTo(at, 9);
      context.fill();
    }
  }

  drawCurves(context, x, y) {
    context.lineWidth = 1.6;
    context.lineJoin = 'round';
    STAGES.forEach((stage, index) => {
      context.strokeStyle = this.hues()[index];
      context.beginPath();
      let before = -Infinity;
      for (const { at_ms, stages } of this.samples) {
        const latency = stages[stage];
        if (!latency || at_ms < this.now - SPAN_MS) continue;
        // Nothing is drawn over a gap.
        if (at_ms - before > 3500) context.moveTo(x(at_ms) - 1, y(latency.p99_ms));
        context.lineTo(x(at_ms), y(latency.p99_ms));
        before = at_ms;
      }
      context.stroke();
    });
  }

  describe() {
    const newest = this.newest();
    const parts = STAGES.filter((stage) => newest?.stages[stage]).map((stage) => `${stage} ${duration(newest.stages[stage].p99_ms)}`);
    const text = `Latency of each stage, p99: ${parts.join(', ') || 'nothing is handled'}`;
    if (this.time.getAttribute('aria-label') !== text) this.time.setAttribute('aria-label', text);
  }
}

export function element(name, kind, text) {
  const made = document.createElement(name);
  if (kind) made.className = kind;
  if (text !== undefined) made.textContent = text;
  return made;
}

/** Sets a text that may be the same as before: nothing is laid out anew for that. */
export function set(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

export function duration(ms) {
  if (ms < 1) return `${Math.round(ms * 1000)} µs`;
  return ms < 1000 ? `${ms < 10 ? ms.toFixed(1) : Math.round(ms)} ms` : `${(ms / 1000).toFixed(1)} s`;
}

export function span(seconds) {
  const [h, m, s] = [Math.floor(seconds / 3600), Math.floor(seconds / 60) % 60, Math.floor(seconds) % 60];
  return h ? `${h} h ${m} min` : m ? `${m} min ${s} s` : `${s} s`;
}
