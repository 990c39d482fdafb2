// Numbers as people read them.

import { decimal } from "../../shared/text.js";

/** Seconds as 1:05. */
export function duration(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

/** Bytes as 34.5 MB. */
export function size(bytes) {
  return `${decimal(bytes / 1e6, bytes < 1e7 ? 1 : 0)} MB`;
}
