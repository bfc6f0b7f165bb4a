// The list of events, newest first, each with what was measured and the limit.

import { DASH, make } from "./format.js";

function figure(value, unit) {
  const text = Math.abs(value) >= 100 ? value.toFixed(0) : String(Number(value.toPrecision(3)));
  return unit ? `${text} ${unit}` : text;
}

export class EventList {
  constructor(list) {
    this.list = list;
    this.shown = new Map();
  }

  show(events) {
    const lines = events.map((event) => {
      const key = `${event.n} ${event.t}`;
      const line = this.shown.get(key) ?? this.line(event);
      return [key, line];
    });
    this.shown = new Map(lines);
    this.list.replaceChildren(...this.shown.values());
  }

  line(event) {
    const line = make("li", undefined, event.kind);
    const stamp = event.t === null ? DASH : `${event.t.toFixed(2)} s`;
    line.append(make("time", stamp, "num"));
    const head = make("span");
    head.append(make("b", event.title));
    if (event.object) head.append(` ${event.object}`);
    if (event.measured !== null) {
      const limit = event.limit === null ? "" : `, limit ${figure(event.limit, event.unit)}`;
      head.append(" ", make("span", `${figure(event.measured, event.unit)}${limit}`, "figures"));
    }
    line.append(head);
    if (event.text) line.append(make("span", event.text, "more"));
    return line;
  }
}
