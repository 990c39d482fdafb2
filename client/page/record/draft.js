// What is typed before a recording is made: kept, so that a reload loses nothing.

import { planned } from "./waypoints.js";

const KEY = "rholoc-recorder-draft";

/** `{map, waypoints}`. */
export function draft() {
  return { map: "room", waypoints: planned(), ...JSON.parse(localStorage.getItem(KEY) ?? "{}") };
}

/** Keep changes of the draft. */
export function keepDraft(changes) {
  localStorage.setItem(KEY, JSON.stringify({ ...draft(), ...changes }));
}
