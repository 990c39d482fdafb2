// Plays a trajectory in a scene: its path as a line, the camera moving along it in its own time.

import { fill, h } from "../shared/dom.js";
import { decimal, t } from "../shared/text.js";

/** Fill `place` with the buttons, and play; gives a function that ends it. `show(pose)` hears of each pose. */
export function play(place, poses, show) {
  const [first, last] = [poses[0].time, poses.at(-1).time];
  const slider = h("input", { type: "range", min: first, max: last, step: "any", value: first, "aria-label": t`Time` });
  const clock = h("span", { class: "mono" });
  const button = h("button", { type: "button" }, t`Pause`);
  let running = true;
  let since = performance.now();
  const showNow = () => {
    const time = Number(slider.value);
    clock.textContent = `${decimal(time - first, 1)} s`;
    show(
      poses[
        Math.max(
          0,
          poses.findLastIndex((pose) => pose.time <= time),
        )
      ],
    );
  };
  const step = (now) => {
    if (!running) return;
    slider.value = String(Math.min(last, Number(slider.value) + (now - since) / 1000));
    since = now;
    showNow();
    if (Number(slider.value) >= last) pause();
    else requestAnimationFrame(step);
  };
  const pause = () => {
    running = false;
    button.textContent = t`Play`;
  };
  const start = () => {
    if (Number(slider.value) >= last) slider.value = String(first);
    running = true;
    since = performance.now();
    button.textContent = t`Pause`;
    requestAnimationFrame(step);
  };
  button.addEventListener("click", () => (running ? pause() : start()));
  slider.addEventListener("input", showNow);
  fill(place, button, slider, clock);
  place.hidden = false;
  start();
  return () => {
    pause();
    place.hidden = true;
  };
}
