// Commands go by HTTP, each with an answer of its own, whether the socket is up or not.

const LIMIT_MS = 3500;
const ABORT_LIMIT_MS = 1500;
const ABORT_AGAIN_MS = 300;
const ABORT_GIVE_UP_MS = 60000;

async function ask(name, token, limitMs) {
  const response = await fetch(`/api/command/${name}`, {
    method: "POST",
    headers: token ? { Authorization: `Bearer ${token}` } : {},
    signal: AbortSignal.timeout(limitMs),
    cache: "no-store",
  });
  const answer = await response.json();
  // Only what may pass by itself is worth another try: a wrong token stays wrong.
  return { ...answer, again: response.status === 429 || response.status >= 500 };
}

export async function command(name, token) {
  const began = performance.now();
  try {
    const answer = await ask(name, token, LIMIT_MS);
    return { ...answer, tookMs: performance.now() - began };
  } catch (error) {
    const text = error.name === "TimeoutError" ? "the page's server gave no answer"
      : "the page's server can't be reached";
    return { accepted: false, answered: false, text, missing: [] };
  }
}

// Asks for an abort until somebody answers. Every press begins one of its own at once, so that one
// that hangs holds up no other; tell(answer or null while it is tried again, tries) says how it goes.
export async function abort(token, tell) {
  const began = performance.now();
  for (let tries = 1; ; tries += 1) {
    const once = performance.now();
    try {
      const answer = await ask("abort", token, ABORT_LIMIT_MS);
      if (!answer.again) {
        tell({ ...answer, tookMs: performance.now() - began }, tries);
        return;
      }
      tell(null, tries, answer.text);
    } catch {
      tell(null, tries, "the page's server can't be reached");
    }
    if (performance.now() - began > ABORT_GIVE_UP_MS) {
      const text = "nobody answered for a minute: use the emergency stop";
      tell({ accepted: false, answered: false, text, missing: [] }, tries);
      return;
    }
    const left = ABORT_AGAIN_MS - (performance.now() - once);
    await new Promise((done) => setTimeout(done, Math.max(left, 50)));
  }
}
