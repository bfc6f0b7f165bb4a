// The table of objects: one row each, written only where something has changed.

import { DASH, fixed, make, milliseconds, setClass, setText, signed } from "./format.js";

const COLUMNS = ["id", "State", "Speed m/s", "To VUT m", "At conflict s", "TTC s", "Off ref. m",
  "Link ms", "Age ms"];

export class ObjectTable {
  constructor(body, count) {
    this.body = body;
    this.count = count;
    this.rows = new Map();
  }

  show(objects, stale) {
    const present = new Set(objects.map((one) => one.id));
    for (const [id, row] of this.rows) {
      if (!present.has(id)) {
        row.line.remove();
        this.rows.delete(id);
      }
    }
    objects.forEach((one, place) => {
      let row = this.rows.get(one.id);
      if (row === undefined) {
        row = this.make(one);
        this.rows.set(one.id, row);
      }
      if (this.body.children[place] !== row.line) {
        this.body.insertBefore(row.line, this.body.children[place] ?? null);
      }
      this.write(row, one, stale);
    });
    setText(this.count, objects.length ? String(objects.length) : "");
  }

  make(one) {
    const line = make("tr");
    line.id = `object-${one.id}`;
    const cells = COLUMNS.map((label) => {
      const cell = make(label === "id" ? "th" : "td");
      cell.dataset.label = label;
      line.append(cell);
      return cell;
    });
    const name = make("td", undefined, "id");
    name.append(make("span", one.id), " ", make("small", one.class));
    cells[0].replaceWith(name);
    return { line, cells };
  }

  write({ line, cells }, one, stale) {
    const silent = stale.blind || one.stale;
    setClass(line, "vut", one.role === "VUT");
    setClass(line, "ot", one.role === "OT");
    setClass(line, "silent", silent);
    const link = one.link ?? {};
    const texts = silent ? Array(7).fill(DASH) : [
      one.control || DASH,
      fixed(one.speed, 2),
      fixed(one.distance, 1),
      arrivals(one.meeting),
      fixed(one.meeting?.ttc, 1),
      one.error ? `${signed(one.error[0], 2)} / ${signed(one.error[1], 2)}` : DASH,
      milliseconds(link.delay),
    ];
    // The age is the one number that is true of a silent object too, while the server is heard.
    texts.push(stale.head === "NOT CONNECTED" ? DASH : milliseconds(one.age));
    texts.forEach((text, index) => setText(cells[index + 1], text));
    setClass(cells[6], "over", !silent && one.error_over);
    setClass(cells[7], "over", !silent && link.over);
    setClass(cells[8], "late", one.late || one.stale);
    const title = link.lost ? `${link.lost} states lost` : "";
    if (cells[7].title !== title) cells[7].title = title;
  }
}

// Until the VUT, and until the object, is where their ways meet; a dash while they don't.
function arrivals(found) {
  if (!found || found.vut === null || found.object === null) return DASH;
  return `${fixed(found.vut, 1)} / ${fixed(found.object, 1)}`;
}
