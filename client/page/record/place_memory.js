// Has the camera seen this before? Corners of a small picture with binary descriptors, compared with those of earlier views.

export const LONG_SIDE = 240; // px, of the picture that is compared
const CELL = 14; // px; each cell gives its strongest corner
const MOST_FEATURES = 90;
const LEAST_CORNER = 60; // the smaller eigenvalue of the gradients' mean products, grey levels squared
const WORDS = 8; // of 32 bits, of a descriptor
const REACH = 12; // px around a corner that its descriptor looks at
const MOST_DISTANCE = 58; // bits of 256 between two descriptors of one corner
const RATIO = 0.85; // to the second nearest
const LEAST_FEATURES = 20; // of a view worth remembering
const SAME_SHARE = 0.45; // of features that agree with the last view, above which nothing new is seen
const LEAST_AGREEING = 12; // matches of an earlier view that move alike
const AGREE_PX = 14; // how far apart their movements may be
const LOOP_AFTER_S = 12; // since the earlier view; before, it is the same look
const MOST_VIEWS = 240;

/** Pairs of points around a corner that a descriptor compares; the same on every phone. */
const PAIRS = makePairs();

function makePairs() {
  let state = 12345;
  const next = () => {
    state = (Math.imul(state, 1103515245) + 12345) & 0x7fffffff;
    return state / 0x7fffffff;
  };
  const offset = () => Math.round((next() + next() - 1) * REACH); // nearer the middle more often
  return Int8Array.from({ length: WORDS * 32 * 4 }, offset);
}

/** Grey levels smoothed by a mean over 5 × 5 pixels. */
function smoothed(grey, width, height) {
  const across = new Float32Array(grey.length);
  const out = new Float32Array(grey.length);
  for (let y = 0; y < height; y++) {
    for (let x = 2; x < width - 2; x++) {
      const at = y * width + x;
      across[at] = (grey[at - 2] + grey[at - 1] + grey[at] + grey[at + 1] + grey[at + 2]) / 5;
    }
  }
  for (let y = 2; y < height - 2; y++) {
    for (let x = 2; x < width - 2; x++) {
      const at = y * width + x;
      out[at] =
        (across[at - 2 * width] + across[at - width] + across[at] + across[at + width] + across[at + 2 * width]) / 5;
    }
  }
  return out;
}

/** The smaller eigenvalue of the mean products of gradients within 5 × 5 pixels (Shi and Tomasi). */
function cornerness(grey, width, x, y) {
  let xx = 0;
  let yy = 0;
  let xy = 0;
  for (let v = -2; v <= 2; v++) {
    for (let u = -2; u <= 2; u++) {
      const at = (y + v) * width + x + u;
      const gx = grey[at + 1] - grey[at - 1];
      const gy = grey[at + width] - grey[at - width];
      xx += gx * gx;
      yy += gy * gy;
      xy += gx * gy;
    }
  }
  return (xx + yy - Math.sqrt((xx - yy) ** 2 + 4 * xy * xy)) / 50;
}

/** Corners of a picture of grey levels: `{count, xy, words}`, two numbers and eight words of 32 bits for each. */
export function featuresOf(grey, width, height) {
  const soft = smoothed(grey, width, height);
  const margin = REACH + 3;
  const found = [];
  for (let top = margin; top < height - margin; top += CELL) {
    for (let left = margin; left < width - margin; left += CELL) {
      let best = { score: LEAST_CORNER, x: -1, y: -1 };
      for (let y = top; y < Math.min(top + CELL, height - margin); y += 2) {
        for (let x = left; x < Math.min(left + CELL, width - margin); x += 2) {
          const score = cornerness(soft, width, x, y);
          if (score > best.score) best = { score, x, y };
        }
      }
      if (best.x >= 0) found.push(best);
    }
  }
  found.sort((a, b) => b.score - a.score);
  const count = Math.min(found.length, MOST_FEATURES);
  const xy = new Float32Array(2 * count);
  const words = new Int32Array(WORDS * count);
  for (let i = 0; i < count; i++) {
    const { x, y } = found[i];
    xy.set([x, y], 2 * i);
    for (let bit = 0; bit < 32 * WORDS; bit++) {
      const at = 4 * bit;
      const one = soft[(y + PAIRS[at + 1]) * width + x + PAIRS[at]];
      const other = soft[(y + PAIRS[at + 3]) * width + x + PAIRS[at + 2]];
      if (one < other) words[i * WORDS + (bit >> 5)] |= 1 << (bit & 31);
    }
  }
  return { count, xy, words };
}

/** How many bits of a word are set. */
const BITS = Uint8Array.from({ length: 65536 }, (_, value) => {
  let count = 0;
  for (let rest = value; rest; rest &= rest - 1) count++;
  return count;
});

/** For each feature of `a` the one of `b` that it is, or -1. */
export function match(a, b) {
  const nearest = new Int32Array(a.count).fill(-1);
  const [mine, theirs] = [a.words, b.words];
  for (let i = 0; i < a.count; i++) {
    let least = MOST_DISTANCE + 1;
    let second = 256;
    let at = -1;
    for (let j = 0; j < b.count; j++) {
      let distance = 0;
      for (let k = 0; k < WORDS && distance < second; k++) {
        const differing = mine[i * WORDS + k] ^ theirs[j * WORDS + k];
        distance += BITS[differing & 0xffff] + BITS[differing >>> 16];
      }
      if (distance < least) {
        second = least;
        least = distance;
        at = j;
      } else if (distance < second) second = distance;
    }
    if (at >= 0 && least < RATIO * second) nearest[i] = at;
  }
  return nearest;
}

/** How many matches move alike from one view to another: those within reach of the best movement. */
export function agreeing(a, b, nearest) {
  const moves = [];
  nearest.forEach((j, i) => {
    if (j >= 0) moves.push([b.xy[2 * j] - a.xy[2 * i], b.xy[2 * j + 1] - a.xy[2 * i + 1]]);
  });
  let best = 0;
  for (const [dx, dy] of moves) {
    const alike = moves.filter(([x, y]) => Math.abs(x - dx) <= AGREE_PX && Math.abs(y - dy) <= AGREE_PX).length;
    if (alike > best) best = alike;
  }
  return best;
}

/** The views of one walk. */
export class PlaceMemory {
  #views = [];

  /** How many different views there are. */
  get count() {
    return this.#views.length;
  }

  /**
   * Look at a picture's features, taken at a time in seconds; gives `{since}`, the time of an earlier view that shows the
   * same, or null. What is new is remembered.
   */
  see(features, time) {
    if (features.count < LEAST_FEATURES) return null;
    const found = this.#seenBefore(features, time);
    const last = this.#views.at(-1);
    const known = last && agreeing(features, last.features, match(features, last.features));
    if (!last || known < SAME_SHARE * Math.min(features.count, last.features.count)) {
      this.#views.push({ features, time });
      if (this.#views.length > MOST_VIEWS) this.#views = this.#views.filter((_, i) => i % 2 === 0);
    }
    return found;
  }

  #seenBefore(features, time) {
    let best = { since: null, count: LEAST_AGREEING - 1 };
    for (const view of this.#views) {
      if (time - view.time < LOOP_AFTER_S) continue;
      const count = agreeing(features, view.features, match(features, view.features));
      if (count > best.count) best = { since: view.time, count };
    }
    return best.since === null ? null : { since: best.since };
  }
}
