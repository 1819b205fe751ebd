// The page's socket: frames come in, what was drawn is answered, orders go out.

const PAUSE_MS = [200, 400, 800, 1500];

/** Keeps a socket open. `on` has `frame(json, sections)`, `open()` and `closed()`; frames are answered by `drawn`. */
export class Link {
  constructor(on) {
    this.on = on;
    this.failures = 0;
    this.orders = 0;
    this.waiting = new Map();
    this.connect();
  }

  connect() {
    const scheme = location.protocol === 'https:' ? 'wss' : 'ws';
    const socket = new WebSocket(`${scheme}://${location.host}/ws`);
    socket.binaryType = 'arraybuffer';
    this.socket = socket;
    socket.onmessage = (message) => {
      const { json, sections } = parse(message.data);
      if (json.hello) {
        this.failures = 0;
        this.on.open();
      }
      for (const reply of json.replies ?? []) {
        this.waiting.get(reply.id)?.(reply);
        this.waiting.delete(reply.id);
      }
      this.on.frame(json, sections);
    };
    socket.onclose = () => {
      this.on.closed();
      for (const answer of this.waiting.values()) answer({ ok: false, text: 'the connection was lost' });
      this.waiting.clear();
      const pause = PAUSE_MS[Math.min(this.failures, PAUSE_MS.length - 1)];
      this.failures += 1;
      setTimeout(() => this.connect(), pause);
    };
  }

  /** Tells that frames up to this one were drawn: the next may come. */
  drawn(frame) {
    this.send({ drawn: frame });
  }

  /** Orders something; resolves to `{ ok, text }`. */
  order(what, token) {
    const id = ++this.orders;
    return new Promise((resolve) => {
      this.waiting.set(id, resolve);
      if (!this.send({ order: { id, token, what } })) {
        this.waiting.delete(id);
        resolve({ ok: false, text: 'there is no connection' });
      }
    });
  }

  send(message) {
    if (this.socket.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }
}

/** A frame: JSON, then sections of a kind (1 map, 2 live, 3 path, 4 scan) each, as DataViews. */
function parse(buffer) {
  const view = new DataView(buffer);
  const end = 4 + view.getUint32(0, true);
  const json = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, end - 4)));
  const sections = [];
  for (let at = end; at < buffer.byteLength; ) {
    const length = view.getUint32(at + 1, true);
    sections.push({ kind: view.getUint8(at), data: new DataView(buffer, at + 5, length) });
    at += 5 + length;
  }
  return { json, sections };
}
