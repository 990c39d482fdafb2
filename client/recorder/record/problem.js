// What keeps a recording from being made or sent, as a person is told it.

/** A title, what to do, and a stable code. */
export class Problem extends Error {
  constructor(code, title, advice = "") {
    super([title, advice].filter(Boolean).join(" "));
    Object.assign(this, { code, title, advice });
  }
}

/** What the browser lacks for recording at all; null when nothing. */
export function missing() {
  if (!window.isSecureContext)
    return new Problem(
      "insecure",
      "Browsers give the camera to pages over HTTPS only.",
      "Start the server with rholoc serve --tls, and open the address that it prints.",
    );
  if (!navigator.mediaDevices?.getUserMedia || !window.MediaRecorder)
    return new Problem("unsupported", "This browser cannot record video.", "Use a recent Chrome, Safari or Firefox.");
  if (!window.indexedDB)
    return new Problem("no-database", "This browser keeps nothing for this page.", "Leave private browsing and try again.");
  return null;
}
