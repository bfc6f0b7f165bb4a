// What became of the commands: the last few, newest first, in words.

import { make, words } from "./format.js";

const MOST = 3;
const SHOWN_MS = 20000;

export class Answers {
  constructor(element) {
    this.element = element;
  }

  // A line for one command, with again(tries, why) and end(answer).
  begin(name) {
    const line = make("div");
    line.dataset.command = name;
    this.write(line, name, "asking …", "");
    this.element.prepend(line);
    while (this.element.children.length > MOST) this.element.lastElementChild.remove();
    return {
      again: (tries, why) => {
        this.write(line, name, `not heard yet, still trying (${tries}): ${why}`, "bad");
      },
      end: (answer) => {
        this.finish(line, name, answer);
        // A refusal stays until newer answers push it out.
        if (answer.accepted) setTimeout(() => line.remove(), SHOWN_MS);
      },
    };
  }

  finish(line, name, answer) {
    if (answer.accepted) {
      const state = answer.state ? `, session ${answer.state}` : "";
      this.write(line, name, `accepted${state} (${answer.tookMs.toFixed(0)} ms)`, "good");
      return;
    }
    const missing = answer.missing ?? [];
    const verdict = answer.answered === false ? "NO ANSWER" : "REFUSED";
    this.write(line, name, missing.length ? verdict : `${verdict}: ${answer.text}`, "bad");
    if (missing.length) {
      const list = make("ul");
      for (const one of missing) list.append(make("li", one));
      line.append(list);
    }
  }

  write(line, name, text, className) {
    const paragraph = make("p");
    paragraph.append(make("b", words(name)), make("span", text, className));
    line.replaceChildren(paragraph);
  }
}
