// The token that commands need: from the part of the address that is never sent to a server.

const KEY = "ssp-page-token";

export function readToken() {
  const found = new URLSearchParams(location.hash.slice(1)).get("token");
  if (found) {
    // Kept for reloads of this tab alone, and taken out of the address, where others may read it.
    sessionStorage.setItem(KEY, found);
    history.replaceState(null, "", location.pathname);
  }
  return sessionStorage.getItem(KEY) ?? "";
}
