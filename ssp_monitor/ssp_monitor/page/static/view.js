// What of the map is on the screen: a centre in metres and a scale, moved by hands and keys.

const LEAST_SCALE = 0.05; // px per m
const MOST_SCALE = 120;
const STEP = 1.35;
const TOOLS_PX = 36; // at the top, where buttons lie over the map

export class View {
  // changed() is called when something else is to be seen; moved() when a person did it.
  constructor(canvas, changed, moved) {
    this.canvas = canvas;
    this.changed = changed;
    this.moved = moved;
    this.x = 0;
    this.y = 0;
    this.scale = 4;
    this.width = 1;
    this.height = 1;
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    for (const kind of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(kind, (event) => this.pointers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  // Metres, east and north, to pixels of the canvas's own box; and back.
  toScreen(x, y) {
    return [this.width / 2 + (x - this.x) * this.scale, this.height / 2 - (y - this.y) * this.scale];
  }

  toMap(px, py) {
    return [this.x + (px - this.width / 2) / this.scale, this.y - (py - this.height / 2) / this.scale];
  }

  // The view in which this much is seen, and at least so many metres of it.
  fitting([left, bottom, right, top], least, margin = 24) {
    const wide = (this.width - 2 * margin) / Math.max(right - left, least);
    const high = (this.height - 2 * margin - TOOLS_PX) / Math.max(top - bottom, least * 0.3);
    const scale = Math.min(Math.max(Math.min(wide, high), LEAST_SCALE), MOST_SCALE);
    return { x: (left + right) / 2, y: (bottom + top) / 2 + TOOLS_PX / 2 / scale, scale };
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toMap(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, LEAST_SCALE), MOST_SCALE);
    // The place under the pointer stays where it is.
    this.x = x - (px - this.width / 2) / this.scale;
    this.y = y + (py - this.height / 2) / this.scale;
    this.changed();
  }

  pan(dx, dy) {
    this.x -= dx / this.scale;
    this.y += dy / this.scale;
    this.moved("pan");
    this.changed();
  }

  key(name) {
    const far = 60;
    const moves = { ArrowLeft: [far, 0], ArrowRight: [-far, 0], ArrowUp: [0, far],
      ArrowDown: [0, -far] };
    if (moves[name]) this.pan(...moves[name]);
    else if (name === "+" || name === "=") this.byHand(STEP);
    else if (name === "-") this.byHand(1 / STEP);
    else return false;
    return true;
  }

  byHand(factor, px, py) {
    this.moved("zoom");
    this.zoom(factor, px, py);
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (before === undefined) return;
    const now = [event.offsetX, event.offsetY];
    if (this.pointers.size === 2) this.pinch(event.pointerId, before, now);
    else this.pan(now[0] - before[0], now[1] - before[1]);
    this.pointers.set(event.pointerId, now);
  }

  pinch(id, before, now) {
    const [other] = [...this.pointers].filter(([one]) => one !== id).map(([, at]) => at);
    const apart = (at) => Math.hypot(at[0] - other[0], at[1] - other[1]);
    this.byHand(apart(now) / Math.max(apart(before), 1), (now[0] + other[0]) / 2,
      (now[1] + other[1]) / 2);
  }

  wheel(event) {
    event.preventDefault();
    this.byHand(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)), event.offsetX,
      event.offsetY);
  }
}
