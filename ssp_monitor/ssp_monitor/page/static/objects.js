// The table of objects: one row each, written only where something has changed.

import { DASH, fixed, make, milliseconds, setClass, setText, signed } from "./format.js";

const COLUMNS = ["id", "State", "Speed m/s", "To VUT m", "Conflict in s", "Off reference m",
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
    const texts = silent ? Array(6).fill(DASH) : [
      one.control || DASH,
      fixed(one.speed, 2),
      fixed(one.distance, 1),
      meeting(one.meeting),
      one.error ? `${signed(one.error[0], 2)} / ${signed(one.error[1], 2)}` : DASH,
      milliseconds(link.delay),
    ];
    // The age is the one number that is true of a silent object too, while the server is heard.
    texts.push(stale.head === "NOT CONNECTED" ? DASH : milliseconds(one.age));
    texts.forEach((text, index) => setText(cells[index + 1], text));
    setClass(cells[5], "over", !silent && one.error_over);
    setClass(cells[6], "over", !silent && link.over);
    setClass(cells[7], "late", one.late || one.stale);
    const title = link.lost ? `${link.lost} states lost` : "";
    if (cells[6].title !== title) cells[6].title = title;
  }
}

// Until the VUT and the object reach the place where their ways meet, and until they would touch.
function meeting(found) {
  if (!found) return DASH;
  const { ttc, vut, object } = found;
  if (ttc === null && (vut === null || object === null)) return DASH;
  const arrivals = `${fixed(vut, 1)} / ${fixed(object, 1)}`;
  return ttc === null ? arrivals : `${arrivals} · TTC ${fixed(ttc, 1)}`;
}
