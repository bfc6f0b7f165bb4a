// How old what is shown is: the one place that decides what may pass for now.

// Snapshots come ten times a second.
const SILENCE_MS = 1500;
// What was on its way for longer is no news.
const LAG_S = 1;

// Returns {head, text, blind, leaderless}: what the banner says, empty when all is fresh; blind when
// of nothing that moves is anything known; leaderless when the session's state isn't known either.
// After an end that was heard, and at which everything stood, silence is no news.
export function staleness(snapshot, silentMs, refusal) {
  const end = snapshot?.end ?? null;
  if (end?.stands) return { head: "", text: "", blind: false, leaderless: false };
  if (silentMs > SILENCE_MS) {
    const since = Number.isFinite(silentMs) ? ` for ${(silentMs / 1000).toFixed(0)} s` : "";
    const why = refusal ? ` (${refusal})` : "";
    return {
      head: "NOT CONNECTED",
      text: `no word from the page's server${since}${why}; trying again. Objects may be moving.`,
      blind: true,
      leaderless: true,
    };
  }
  if (end !== null) {
    return {
      head: "NOT KNOWN TO STAND",
      text: `${end.head}; ${end.text}`,
      blind: true,
      leaderless: false,
    };
  }
  if (snapshot === null) return { head: "NO DATA", text: "connecting", blind: true, leaderless: true };
  if (snapshot.lag > LAG_S) {
    return {
      head: "SLOW CONNECTION",
      text: `what comes from the page's server is up to ${snapshot.lag.toFixed(1)} s old. ` +
        "Objects are elsewhere by now.",
      blind: true,
      leaderless: true,
    };
  }
  if (snapshot.stale.length === 0) {
    // Known before anybody presses: the session may be seen while its services aren't found yet.
    if (!snapshot.abort_unheard) return { head: "", text: "", blind: false, leaderless: false };
    return {
      head: "ABORT NOT HEARD",
      text: "no scenario manager accepts ABORT yet; a press is repeated until one does.",
      blind: false,
      leaderless: false,
    };
  }
  const [first, second, ...more] = snapshot.stale;
  const text = [first, second].filter(Boolean).join("; ");
  return {
    head: snapshot.blind ? "NO DATA" : "STALE DATA",
    text: more.length ? `${text}; and ${more.length} more` : text,
    blind: snapshot.blind,
    leaderless: snapshot.leaderless,
  };
}
