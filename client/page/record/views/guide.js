// Three pictures to look at before the first walk: what makes a good map.

import { h } from "../../shared/dom.js";
import { t } from "../../shared/text.js";

const SVG = "http://www.w3.org/2000/svg";
const SEEN = "rholoc-recorder-guide-seen";

// Lines of each picture in a field of 120 × 72: [class, path]. "strong" is the subject, "faint" its surroundings.
const PICTURES = [
  [
    t`Walk slowly, and sideways where you can; do not turn on the spot. Keep things in view: furniture, posters, shelves, no bare walls.`,
    [
      ["faint", "M12 14h20v16h-20zM40 10h14v20h-14zM62 14h22v16h-22zM92 10h16v20h-16z"],
      ["strong", "M18 56H96M86 48l10 8l-10 8"],
      ["faint thin", "M34 56V38M58 56V38M80 56V38"],
    ],
  ],
  [
    t`Come back to where you began, and look at it again as you did then: the loop shows the map its own errors.`,
    [
      ["strong", "M34 54C8 40 22 12 58 12S108 28 96 46S60 62 46 56"],
      ["strong", "M56 48l-10 8l10 8"],
      ["strong thin", "M34 54m-5 0a5 5 0 1 0 10 0a5 5 0 1 0-10 0"],
    ],
  ],
  [
    t`Optional: measure three points or more, not on one line. Stand still at each for two seconds, and mark it.`,
    [
      ["faint", "M10 62V12H110V62"],
      ["strong", "M24 52h.1M62 26h.1M96 52h.1"],
      ["dashed", "M24 52L62 26L96 52"],
      ["faint", "M24 60v4M96 60v4M24 62h72"],
    ],
  ],
];

/** The pictures, open until someone has seen them. */
export function guide() {
  const details = h(
    "details",
    { class: "card guide", open: localStorage.getItem(SEEN) === null },
    h("summary", {}, h("strong", {}, t`Before the first walk`)),
    h(
      "ol",
      { class: "plain stack" },
      PICTURES.map(([text, lines], i) => h("li", {}, drawing(lines), h("p", {}, `${i + 1}. ${text}`))),
    ),
    h("button", { type: "button", onclick: () => (details.open = false) }, t`Got it`),
  );
  details.addEventListener("toggle", () => !details.open && localStorage.setItem(SEEN, "yes"));
  return details;
}

function drawing(lines) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 120 72");
  svg.setAttribute("aria-hidden", "true"); // the text beside it says it
  for (const [kind, d] of lines) {
    const path = document.createElementNS(SVG, "path");
    path.setAttribute("class", kind);
    path.setAttribute("d", d);
    svg.append(path);
  }
  return svg;
}
