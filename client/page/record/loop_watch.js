// Watches a walk for places that it has been at before; the comparing is done by a worker.

import { greyLevels } from "./coaching.js";
import { LONG_SIDE } from "./place_memory.js";

const EVERY_S = 1;
const CONFIRMED = 2; // looks in a row that know the place

export class LoopWatch {
  views = 0; // different ones so far
  loops = 0; // returns to an earlier place
  here = false; // whether the camera is at one now
  #busy = false;
  #asked = -Infinity;
  #known = 0;
  #newAt = 0; // when a view was new, or an earlier place was seen again, s
  #worker = null;

  constructor(video) {
    this.video = video;
    this.context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
    try {
      this.#worker = new Worker(new URL("./loop_worker.js", import.meta.url), { type: "module" });
    } catch {
      return; // a browser without: the walk goes on without the hint
    }
    this.#worker.addEventListener("message", ({ data }) => this.#hear(data));
    this.#worker.addEventListener("error", () => this.close());
  }

  /** Whether it compares at all. */
  get works() {
    return this.#worker !== null;
  }

  /** How long the camera has seen nothing but one view [s]. */
  get stoodS() {
    return Math.max(0, this.#asked - this.#newAt);
  }

  /** Look at the picture, at a time in seconds after the start; at most once a second, and never while it compares. */
  look(time) {
    const { videoWidth, videoHeight } = this.video;
    if (!this.#worker || this.#busy || !videoWidth || time - this.#asked < EVERY_S) return;
    this.#asked = time;
    this.#busy = true;
    const scale = LONG_SIDE / Math.max(videoWidth, videoHeight);
    const [width, height] = [videoWidth, videoHeight].map((size) => Math.round(scale * size));
    const { canvas } = this.context;
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    this.context.drawImage(this.video, 0, 0, width, height);
    const grey = greyLevels(this.context.getImageData(0, 0, width, height).data);
    this.#worker.postMessage({ grey, width, height, time }, [grey.buffer]);
  }

  #hear({ since, views }) {
    this.#busy = false;
    if (views !== this.views || since !== null) this.#newAt = this.#asked;
    this.views = views;
    this.#known = since === null ? 0 : this.#known + 1;
    const here = this.#known >= CONFIRMED;
    if (here && !this.here) this.loops++;
    this.here = here;
  }

  close() {
    this.#worker?.terminate();
    this.#worker = null;
  }
}
