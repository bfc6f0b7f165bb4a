// Commands go by HTTP, each with an answer of its own, whether the socket is up or not.

const LIMIT_MS = 3500;
const ABORT_LIMIT_MS = 1500;
const ABORT_AGAIN_MS = 300;
const ABORT_GIVE_UP_MS = 60000;
// A browser has few connections to one server; none is taken from the presses to come.
const MOST_OPEN = 4;
let open = 0;

async function ask(name, token, limitMs, body) {
  const response = await fetch(`/api/command/${name}`, {
    method: "POST",
    body,
    headers: token ? { Authorization: `Bearer ${token}` } : {},
    signal: AbortSignal.timeout(limitMs),
    cache: "no-store",
  });
  const answer = await response.json();
  // Only what may pass by itself is worth another try: a wrong token stays wrong.
  const again = response.status === 429 || response.status >= 500;
  const refused = ["no token", "wrong token"].find((why) => answer.text.startsWith(why)) ?? "";
  return { ...answer, again, refused };
}

// shown: the session state that the page showed at the press, as the snapshot names it.
export async function command(name, token, shown) {
  const began = performance.now();
  try {
    const answer = await ask(name, token, LIMIT_MS, JSON.stringify({ shown }));
    return { ...answer, tookMs: performance.now() - began };
  } catch (error) {
    return { accepted: false, answered: false, text: cause(error), missing: [] };
  }
}

function cause(error) {
  return error.name === "TimeoutError" ? "the page's server gave no answer"
    : "the page's server can't be reached";
}

// One try for an abort; text alone when nobody could be asked.
async function tryAbort() {
  if (open >= MOST_OPEN) return { again: true, text: `${open} requests are still on their way` };
  open += 1;
  try {
    return await ask("abort", "", ABORT_LIMIT_MS); // ABORT needs no token
  } catch (error) {
    return { again: true, text: cause(error) };
  } finally {
    open -= 1;
  }
}

// Asks for an abort until somebody answers. Every press begins one of its own at once, so that one
// that hangs holds up no other; tell(answer or null while it is tried again, tries) says how it goes.
export async function abort(tell) {
  const began = performance.now();
  for (let tries = 1; ; tries += 1) {
    const once = performance.now();
    const answer = await tryAbort();
    if (!answer.again) {
      tell({ ...answer, tookMs: performance.now() - began }, tries);
      return;
    }
    tell(null, tries, answer.text);
    if (performance.now() - began > ABORT_GIVE_UP_MS) {
      const text = "no answer for a minute: use the emergency stop";
      tell({ accepted: false, answered: false, text, missing: [] }, tries);
      return;
    }
    const left = ABORT_AGAIN_MS - (performance.now() - once);
    await new Promise((done) => setTimeout(done, Math.max(left, 50)));
  }
}
