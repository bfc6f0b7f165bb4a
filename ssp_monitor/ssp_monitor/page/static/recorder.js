// Is everything being recorded, and for how long can it go on?

import { DASH, byId, bytes, duration, fixed, make, setText } from "./format.js";

const SILENCE_S = 2.5;
const LITTLE_S = 600;

export class Recorder {
  constructor() {
    this.list = byId("recorder");
    this.cells = new Map();
    this.told = "";
  }

  show(snapshot, stale) {
    if (snapshot === null) return;
    const found = snapshot.recorder;
    const age = snapshot.ages.recorder;
    const silent = stale.blind && stale.head === "NOT CONNECTED" || age === null || age > SILENCE_S;
    const [word, good] = this.word(found, silent, snapshot.end);
    const badge = byId("recorder-word");
    setText(badge, word);
    badge.className = `badge ${good ? "good" : "bad"}`;
    this.brief(word, good, found, silent, snapshot.end);
    const value = (text) => (silent || found === null ? DASH : text);
    this.write("Written", value(found && `${bytes(found.bytes)}`));
    this.write("Rate", value(found && (found.rate ? `${bytes(found.rate)}/s` : DASH)));
    this.write("Disk lasts", value(found && duration(found.disk_left_s)),
      found && found.disk_left_s !== null && found.disk_left_s < LITTLE_S);
    this.write("Free", value(found && bytes(found.free_bytes)));
    this.write("Lost", value(found && String(found.lost)), found && found.lost > 0);
    this.write("Queue", value(found && (found.queue === null ? DASH
      : `${fixed(found.queue * 100, 0)} %`)), found && found.queue > 0.5);
    this.notes(found, silent);
  }

  // The same in the header, where it is seen without scrolling.
  brief(word, good, found, silent, end) {
    const cell = byId("recorder-brief");
    const parts = [word];
    if (found !== null && !silent) {
      parts.push(`${found.lost} lost`);
      if (!end) parts.push(`disk ${duration(found.disk_left_s)}`);
    }
    setText(cell, parts.join(" · "));
    const little = found !== null && !end && found.disk_left_s !== null
      && found.disk_left_s < LITTLE_S;
    cell.className = good && !little ? "num" : "num bad";
  }

  word(found, silent, end) {
    if (found === null) return ["not heard", false];
    if (found.failure) return ["FAILED", false];
    if (found.lost > 0) return [end ? "LOST" : "LOSING", false];
    if (end) return ["ended", true];
    if (silent) return ["SILENT", false];
    return found.ready ? ["recording", true] : ["not ready", false];
  }

  write(label, text, bad) {
    let cell = this.cells.get(label);
    if (cell === undefined) {
      const box = make("div");
      cell = make("dd", undefined, "num");
      box.append(make("dt", label), cell);
      this.list.append(box);
      this.cells.set(label, cell);
    }
    setText(cell, text);
    cell.className = bad ? "num bad" : "num";
  }

  notes(found, silent) {
    const notes = [];
    if (found !== null && !silent) {
      if (found.failure) notes.push(`nothing is recorded any more: ${found.failure}`);
      if (found.missing.length) notes.push(`not heard: ${found.missing.join(", ")}`);
      notes.push(...found.warnings);
      for (const topic of found.topics) {
        notes.push(`${topic.name}: ${topic.lost} lost, ${topic.dropped} dropped`);
      }
    }
    const key = JSON.stringify(notes);
    if (key === this.told) return;
    this.told = key;
    byId("recorder-notes").replaceChildren(...notes.map((note) => make("li", note, "bad")));
  }
}
