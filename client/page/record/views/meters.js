// What is measured while walking, as bars: each is full where all is well.

import { h } from "../../shared/dom.js";
import { t } from "../../shared/text.js";
import { BAREST, DARKEST, FASTEST_TURN_DEG_S, LEAST_SHARP } from "../coaching.js";

// A bar's name, what it shows of the measurements, what it needs at the least, and what fills it.
const BARS = [
  [t`Light`, ({ light }) => light, DARKEST, 0.5],
  [t`Texture`, ({ texture }) => texture, BAREST, 0.6],
  [t`Sharpness`, ({ sharpness }) => sharpness, LEAST_SHARP, 0.75],
  [
    t`Calm`,
    ({ turnDegS }) => (turnDegS === null ? null : FASTEST_TURN_DEG_S - turnDegS / 2),
    FASTEST_TURN_DEG_S / 2,
    FASTEST_TURN_DEG_S,
  ],
];

/** An element, and `show(measured)`. */
export function meters() {
  const bars = BARS.map(([name, read, least, full]) => {
    const bar = h("meter", { min: 0, max: full, low: least, high: least, optimum: full, value: 0, "aria-label": name });
    return { bar, read, element: h("span", { class: "meter" }, h("span", {}, name), bar) };
  });
  const show = (measured) => {
    for (const { bar, read, element } of bars) {
      const value = read(measured);
      element.classList.toggle("unknown", value === null);
      bar.value = Math.max(0, value ?? 0);
    }
  };
  return {
    element: h(
      "div",
      { class: "meters" },
      bars.map(({ element }) => element),
    ),
    show,
  };
}
