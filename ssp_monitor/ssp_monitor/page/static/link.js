// The WebSocket to the server: hello, messages, and coming back by itself.

const FIRST_WAIT_MS = 250;
const LONGEST_WAIT_MS = 4000;
const OPEN_LIMIT_MS = 4000;
// A socket that is open and says nothing for so long is given up.
const SILENCE_MS = 4000;

export class Link {
  // handlers: {message(object), picture(blob), up(), down(reason)}
  constructor(token, handlers) {
    this.token = token;
    this.handlers = handlers;
    this.wait = FIRST_WAIT_MS;
    this.lastWord = -Infinity;
    this.socket = null;
    this.lag = Infinity;
    this.connect();
    setInterval(() => this.watch(), 500);
    // A tablet that comes out of its pocket, or back into range, doesn't wait for the backoff.
    for (const kind of ["online", "focus", "pageshow"]) {
      addEventListener(kind, () => this.hurry());
    }
  }

  get silentMs() {
    return performance.now() - this.lastWord;
  }

  connect() {
    clearTimeout(this.timer);
    const socket = new WebSocket(`ws://${location.host}/api/live`);
    this.socket = socket;
    this.echoed = null;
    this.waiting = null;
    this.began = performance.now();
    socket.binaryType = "blob";
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", token: this.token }));
    socket.onmessage = (event) => this.take(socket, event.data);
    socket.onclose = (event) => this.lost(socket, event.reason);
  }

  take(socket, data) {
    if (socket !== this.socket) return;
    if (data instanceof Blob) {
      this.handlers.picture(data);
      return;
    }
    const message = JSON.parse(data);
    // A snapshot is shown once its bundle's mark tells how long it was on its way.
    if (message.type === "snapshot") {
      this.waiting = message;
      return;
    }
    if (message.type === "mark") {
      this.mark(message, socket);
      return;
    }
    if (message.type === "welcome") this.handlers.up();
    this.handlers.message(message);
  }

  // The end of a bundle. The next one is sent only when this one is confirmed, so that the time since
  // the last confirmation, less what the server held it, bounds the age of what has come.
  mark(message, socket) {
    const now = performance.now();
    if (this.echoed !== null) {
      this.lag = Math.max((now - this.echoed) / 1000 - message.held_s, 0);
    }
    this.echoed = now;
    socket.send(JSON.stringify({ echo: message.n }));
    const snapshot = this.waiting;
    if (snapshot === null) return;
    this.waiting = null;
    this.lastWord = now;
    this.wait = FIRST_WAIT_MS;
    this.handlers.message({ ...snapshot, lag: this.lag });
  }

  lost(socket, reason) {
    if (socket !== this.socket) return;
    this.socket = null;
    this.handlers.down(reason);
    clearTimeout(this.timer);
    // Many pages that come back at once don't come at the same instant.
    this.timer = setTimeout(() => this.connect(), this.wait * (0.75 + 0.5 * Math.random()));
    this.wait = Math.min(this.wait * 2, LONGEST_WAIT_MS);
  }

  watch() {
    const socket = this.socket;
    if (socket === null) return;
    const opening = socket.readyState === WebSocket.CONNECTING;
    const since = performance.now() - Math.max(this.began, this.lastWord);
    if (since > (opening ? OPEN_LIMIT_MS : SILENCE_MS)) {
      socket.onclose = null;
      socket.close();
      this.lost(socket, "silent");
    }
  }

  hurry() {
    this.wait = FIRST_WAIT_MS;
    if (this.socket === null) this.connect();
  }
}
