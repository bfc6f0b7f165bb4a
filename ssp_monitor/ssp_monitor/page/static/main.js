// Puts the parts together: what the server says goes to the panels, what people press goes back.

import { Answers } from "./answers.js";
import { Camera } from "./camera.js";
import { abort, command } from "./commands.js";
import { EventList } from "./events.js";
import { byId, make, setClass, setText } from "./format.js";
import { Link } from "./link.js";
import { SiteMap } from "./map.js";
import { ObjectTable } from "./objects.js";
import { Recorder } from "./recorder.js";
import { SessionPanel } from "./session.js";
import { staleness } from "./stale.js";
import { readToken } from "./token.js";

const token = readToken();
const answers = new Answers(byId("answers"));

// -- abort: before everything else, so that it works whatever else doesn't ------------------------

function pressAbort() {
  const button = byId("abort");
  const line = answers.begin("abort");
  button.classList.add("pressed");
  setTimeout(() => button.classList.remove("pressed"), 200);
  abort((answer, tries, why) => {
    if (answer === null) line.again(tries, why);
    else finish(line, answer);
  });
}

const button = byId("abort");
// The press counts, not the release: a finger that slips off has pressed all the same.
button.addEventListener("pointerdown", (event) => {
  event.preventDefault();
  pressAbort();
});
button.addEventListener("click", (event) => {
  // Of the pointer's click nothing is left to do; the keyboard's, and assistive technology's, has
  // no press before it.
  if (event.detail === 0) pressAbort();
});

// Keyboards on a screen, and some layouts, give no code.
function isSpace(event) {
  return event.code === "Space" || event.key === " ";
}

addEventListener("keydown", (event) => {
  if (!isSpace(event)) return;
  event.preventDefault();
  event.stopPropagation();
  if (!event.repeat) pressAbort();
}, { capture: true });
// Without this a focused button would be pressed as well, when the bar is let go.
addEventListener("keyup", (event) => {
  if (isSpace(event)) event.preventDefault();
}, { capture: true });

function finish(line, answer) {
  line.end(answer);
  if (answer.refused) deny(answer.refused);
}

// This tab's token isn't the page's: of another start of it, most likely.
function deny(why) {
  const note = byId("no-token");
  const wrong = why === "wrong token";
  note.hidden = false;
  note.className = wrong ? "banner dead" : "banner warn";
  const text = `View and ABORT only: ${why}. All other commands are refused here. ` +
    "Open the page at the address with #token= that was printed when it started.";
  if (note.dataset.why === why) return;
  note.dataset.why = why;
  note.replaceChildren(...(wrong ? [make("strong", "ONLY ABORT WORKS IN THIS TAB")] : []),
    make("span", text));
}

// -- the panels ------------------------------------------------------------------------------------

const session = new SessionPanel(run);
const objects = new ObjectTable(byId("objects"), byId("objects-count"));
const events = new EventList(byId("events"));
const recorder = new Recorder();
const camera = new Camera();
const map = new SiteMap(byId("map"), byId("map-note"));

let snapshot = null;
let allowed = false;
let refusal = "";
let drawn = "";

const link = new Link(token, {
  message(message) {
    if (message.type === "snapshot") {
      snapshot = message;
      show();
    } else if (message.type === "site") {
      map.setSite(message);
      camera.expect(message.camera);
    } else if (message.type === "events") {
      events.show(message.events);
    } else if (message.type === "welcome") {
      welcome(message);
    }
  },
  picture: (blob) => camera.take(blob),
  up() {
    refusal = "";
  },
  down(reason) {
    refusal = reason;
    show();
  },
});

function welcome(message) {
  allowed = message.may_command;
  if (allowed) {
    byId("no-token").hidden = true;
  } else {
    deny(message.why);
  }
}

// -- showing -----------------------------------------------------------------------------------

function show() {
  const state = staleness(snapshot, link.silentMs, refusal);
  banner(state);
  byId("replay").hidden = !snapshot?.replay;
  setClass(document.body, "stale", state.head !== "");
  setClass(document.body, "blind", state.blind);
  const end = snapshot?.end ?? null;
  const unheard = state.head === "NOT CONNECTED" || (snapshot?.abort_unheard ?? true);
  const hint = byId("abort-hint");
  const dead = unheard || end !== null;
  setText(hint, end?.stands ? "the run has ended" : dead ? "not heard now" : "space bar");
  // Of use only where there is a keyboard.
  setClass(hint, "key", !dead);
  ended(end, snapshot);
  session.show(snapshot, state, allowed);
  recorder.show(snapshot, state);
  camera.show(snapshot, state);
  objects.show(snapshot ? snapshot.objects : [], state);
  map.show(snapshot ? snapshot.objects : [], state);
  title(state);
}

// What a run came to stands until another one is seen, whether its server is still there or not.
function ended(end, snapshot) {
  const band = byId("ended");
  band.hidden = !end?.stands;
  if (end === null) return;
  setText(byId("ended-head"), end.head);
  setText(byId("ended-text"), `${end.text}.`);
  setClass(band, "valid", snapshot.session.verdict === "VALID");
}

function banner(state) {
  const element = byId("banner");
  element.hidden = state.head === "";
  setText(byId("banner-head"), state.head);
  setText(byId("banner-text"), state.text);
}

function title(state) {
  const name = snapshot ? snapshot.session.state : "no data";
  const what = state.head || (snapshot?.end?.head ?? name);
  const text = snapshot?.replay ? `REPLAY ${what} – SSP` : `${what} – SSP`;
  if (text !== drawn) {
    drawn = text;
    document.title = text;
  }
}

// Silence must be seen too, and it brings no message.
setInterval(show, 200);

// -- commands ----------------------------------------------------------------------------------

async function run(name, button, shown) {
  const line = answers.begin(name);
  button.classList.add("waiting");
  finish(line, await command(name, token, shown));
  button.classList.remove("waiting");
}

byId("not-started").remove();
