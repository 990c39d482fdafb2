// The directions that a walk has looked in, as a ring that fills: the direction of now is marked.

import { h } from "../../shared/dom.js";
import { t } from "../../shared/text.js";
import { ENOUGH_S, SECTORS } from "../headings.js";

const SVG = "http://www.w3.org/2000/svg";
const [OUTER, INNER, GAP] = [30, 21, 0.06];

/** An element, and `show(headings, views, loops)`. */
export function ring() {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "-36 -36 72 72");
  svg.setAttribute("aria-hidden", "true");
  const part = (name, attributes) => {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    svg.append(made);
    return made;
  };
  const sectors = Array.from({ length: SECTORS }, (_, i) => part("path", { d: sector(i) }));
  const needle = part("path", { d: "M0 -35l5 7h-10z", class: "needle" });
  const middle = part("text", { "text-anchor": "middle", y: 5 });
  const text = h("span", { class: "visually-hidden" });
  const element = h("span", { class: "ring", hidden: true }, svg, text);

  function show(headings, views, loops) {
    element.hidden = false;
    sectors.forEach((one, i) => {
      one.setAttribute("class", headings.seen[i] >= ENOUGH_S ? "seen" : headings.seen[i] > 0 ? "glimpsed" : "");
    });
    needle.setAttribute("transform", `rotate(${(headings.heading * 180) / Math.PI})`);
    middle.textContent = loops ? "✓" : String(views);
    text.textContent = t`${headings.covered} of ${SECTORS} directions seen, different views: ${views}, loops closed: ${loops}`;
  }

  return { element, show };
}

/** A sector of the ring; the first is up, the others follow to the right. */
function sector(i) {
  const width = (2 * Math.PI) / SECTORS;
  const [from, to] = [(i - 0.5) * width + GAP, (i + 0.5) * width - GAP];
  const at = (radius, angle) => `${(radius * Math.sin(angle)).toFixed(2)} ${(-radius * Math.cos(angle)).toFixed(2)}`;
  return `M${at(OUTER, from)}A${OUTER} ${OUTER} 0 0 1 ${at(OUTER, to)}L${at(INNER, to)}A${INNER} ${INNER} 0 0 0 ${at(INNER, from)}Z`;
}
