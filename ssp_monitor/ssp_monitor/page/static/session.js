// State of the session, large; what stands in its way; and the buttons that it takes.

import { DASH, byId, clock, make, setClass, setText, words } from "./format.js";

const BUTTONS = ["connect", "arm", "start", "stop", "disarm", "all_clear", "reset"];
// More than these are folded away.
const MOST_REASONS = 7;

export class SessionPanel {
  // press(name, button, shown) runs a command for the state that was shown when it was pressed.
  constructor(press) {
    this.buttons = new Map();
    for (const name of BUTTONS) {
      const button = make("button", words(name), name);
      button.type = "button";
      button.id = `command-${name}`;
      button.disabled = true;
      let pressedFor = "";
      button.addEventListener("pointerdown", () => { pressedFor = this.shown; });
      button.addEventListener("click", (event) => {
        // The keyboard's click, and assistive technology's, has no press before it.
        press(name, button, event.detail === 0 ? this.shown : pressedFor);
      });
      byId("commands").append(button);
      this.buttons.set(name, button);
    }
    this.state = byId("state");
    this.head = make("h3");
    this.first = make("ul");
    // Stays as it was opened while its reasons change. The space bar is ABORT here too.
    this.more = make("summary");
    this.rest = make("ul");
    this.rest.tabIndex = 0;
    this.fold = make("details");
    this.fold.append(this.more, this.rest);
    byId("standing").append(this.head, this.first, this.fold);
    this.told = "";
    this.shown = "";
  }

  show(snapshot, stale, allowed) {
    if (snapshot === null) return;
    const session = snapshot.session;
    const known = !stale.leaderless;
    setText(this.state, session.shown);
    this.shown = session.press;
    const className = `state ${session.state.toLowerCase()}${known ? "" : " old"}`;
    if (this.state.className !== className) this.state.className = className;
    setText(byId("state-why"), known ? this.why(session) : `last known: ${session.shown}`);
    setText(byId("scenario"), session.scenario || DASH);
    const stand = session.stand_in ? " · stand-in site" : "";
    const run = [session.run_id, session.site && `on ${session.site}`, session.mode]
      .filter(Boolean).join(" · ");
    setText(byId("run"), run ? run + stand : DASH);
    setText(byId("phase"), known && session.phase ? session.phase.toLowerCase() : DASH);
    setText(byId("elapsed"), known ? clock(session.elapsed_s) : DASH);
    setText(byId("next"), known && session.next ? `Next: ${session.next}.` : "");
    for (const [name, button] of this.buttons) {
      const disabled = !(allowed && known && session.commands.includes(name));
      if (button.disabled !== disabled) button.disabled = disabled;
    }
    this.standing(snapshot, known);
  }

  why(session) {
    if (session.verdict !== "NONE") {
      const verdict = words(session.verdict).toLowerCase();
      return session.reasons.length ? `${verdict}: ${session.reasons.join("; ")}` : verdict;
    }
    return session.reason || session.event;
  }

  standing(snapshot, known) {
    const state = snapshot.session.state;
    const before = ["UNKNOWN", "IDLE", "LOADED", "CONNECTED", "ARMED"].includes(state);
    const waiting = before && snapshot.end === null;
    const key = JSON.stringify([waiting, known, state === "ARMED", snapshot.standing]);
    if (key === this.told) return;
    this.told = key;
    byId("standing").hidden = !waiting;
    if (!waiting) return;
    const what = state === "ARMED" ? "the start" : "arming";
    const reasons = known ? snapshot.standing : [];
    if (!known) setText(this.head, "What prevents arming isn't known now");
    else if (reasons.length) setText(this.head, `Prevents ${what}`);
    else setText(this.head, `Nothing seen that prevents ${what}`);
    setClass(this.head, "bad", !known || reasons.length > 0);
    setClass(this.head, "good", known && reasons.length === 0);
    const items = reasons.map((reason) => make("li", reason));
    this.first.replaceChildren(...items.slice(0, MOST_REASONS));
    this.rest.replaceChildren(...items.slice(MOST_REASONS));
    this.fold.hidden = items.length <= MOST_REASONS;
    setText(this.more, `and ${items.length - MOST_REASONS} more`);
  }
}
