// What keeps a recording from being made or sent, in words for people.

import { t } from "../shared/text.js";

/** A title, what to do, and a stable code. */
export class Problem extends Error {
  constructor(code, title, advice = "") {
    super([title, advice].filter(Boolean).join(" "));
    this.code = code;
    this.title = title;
    this.advice = advice;
  }
}

/** What the browser lacks for recording at all; null when nothing. */
export function missing() {
  if (!window.isSecureContext)
    return new Problem(
      "insecure",
      t`Browsers give the camera to pages over HTTPS only.`,
      t`Film the walk with the phone's camera app and upload the video. Or start the server with rholoc serve --tls, and open the address that it prints.`,
    );
  if (!navigator.mediaDevices?.getUserMedia || !window.MediaRecorder)
    return new Problem("unsupported", t`This browser cannot record video.`, t`Use a recent Chrome, Safari or Firefox.`);
  if (!window.indexedDB)
    return new Problem(
      "no-database",
      t`This browser stores nothing for this page.`,
      t`Leave private browsing and try again.`,
    );
  return null;
}
