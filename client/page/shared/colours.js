// The design's colours for what is drawn on a canvas, which does not know of custom properties or of light and dark.

/** A colour of the design, such as `--ink`, as `rgb(…)` in an element's present scheme. */
export function resolvedColour(element, token) {
  const before = element.style.color;
  element.style.color = `var(${token})`;
  const { color } = getComputedStyle(element);
  element.style.color = before;
  return color;
}
