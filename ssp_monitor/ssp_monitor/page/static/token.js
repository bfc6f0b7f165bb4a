// The token that commands need: from the part of the address that is never sent to a server.

const KEY = "ssp-page-token";

export function readToken() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found) {
    // Kept for reloads of this tab alone, and taken out of the address, where others may read it.
    try {
      sessionStorage.setItem(KEY, found);
    } catch {
      // Where storage is blocked the token lives as long as the page does, in its caller's hands.
    }
    history.replaceState(null, "", location.pathname);
    return found;
  }
  try {
    return sessionStorage.getItem(KEY) ?? "";
  } catch {
    return "";
  }
}
