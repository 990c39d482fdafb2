// What was measured while a walk was recorded, and which of its seconds the map will not be made of.

import { flaws } from "./coaching.js";

const MOST_OF = 0.5; // of a second's measurements that must have a flaw, for the second to have it
const GAP_S = 1; // between spans of one flaw, that are reported as one

/** Measurements, each at its time in seconds after the start: `{time, light, texture, sharpness, turnDegS}`. */
export class Readings {
  all = [];

  add(time, measured) {
    this.all.push({ time, ...measured });
  }

  /** The lights in order, for a curve. */
  get lights() {
    return this.all.map(({ light }) => light).filter((light) => light !== null);
  }

  /** The least light, or null. */
  get darkest() {
    const { lights } = this;
    return lights.length ? lights.reduce((least, light) => Math.min(least, light)) : null;
  }

  /** Each second's flaws, from the first to the last. */
  seconds() {
    const bySecond = [];
    for (const reading of this.all) (bySecond[Math.floor(reading.time)] ??= []).push(flaws(reading));
    return Array.from(bySecond, (found = []) => {
      const counts = new Map();
      for (const flaw of found.flat()) counts.set(flaw, (counts.get(flaw) ?? 0) + 1);
      return [...counts].filter(([, count]) => count > MOST_OF * found.length).map(([flaw]) => flaw);
    });
  }
}

/** Spans of seconds that share a flaw, `{flaw, from, to}` in seconds, by their beginning; `to` is not part of it. */
export function flawedSpans(seconds) {
  const spans = [];
  for (const flaw of new Set(seconds.flat())) {
    let span = null;
    seconds.forEach((found, second) => {
      if (!found.includes(flaw)) return;
      if (span && second - span.to <= GAP_S) span.to = second + 1;
      else spans.push((span = { flaw, from: second, to: second + 1 }));
    });
  }
  return spans.sort((a, b) => a.from - b.from);
}
