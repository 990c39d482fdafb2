// What several parts of the console show.

import { serverIsBack } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { t, translated } from "../shared/text.js";
import { restsOnGivenPoses, Trust, trustOf } from "../shared/trust.js";

const STATES = { published: "good", failed: "bad", cancelled: "warn" };
const TRUST_BADGES = {
  [Trust.YES]: ["good", t`trusted`],
  [Trust.NO]: ["bad", t`not trusted`],
  [Trust.UNKNOWN]: ["warn", t`not checked`],
};

/** A page: its heading with what stands beside it, and its content. */
export function page(heading, beside, ...content) {
  return h("div", { class: "stack" }, h("div", { class: "row spread" }, h("h1", {}, heading), beside), content);
}

/** An error with what to do about it, and a button to try again. */
export function problem(error, again) {
  return h(
    "div",
    { class: "notice bad stack", role: "alert" },
    h("p", {}, h("strong", {}, error.summary ?? error.message)),
    error.hint && h("p", {}, error.hint),
    error.code === "unreachable" && h("p", {}, t`This page continues by itself when it is back.`),
    h(
      "div",
      { class: "row" },
      again && h("button", { type: "button", onclick: again }, t`Try again`),
      error.status === 404 && h("a", { class: "button", href: "#/maps" }, t`To the maps`),
    ),
  );
}

/** Grey shapes of the size of what is to come. */
export function skeletons(number, size) {
  return Array.from({ length: number }, () => h("div", { class: `skeleton ${size}`, "aria-hidden": "true" }));
}

/** A place where something comes to be: `load` fills it; its error is shown in its place. */
export async function loading(element, load, signal) {
  element.setAttribute("aria-busy", "true");
  try {
    await load();
  } catch (error) {
    if (signal.aborted) return;
    fill(
      element,
      problem(error, () => loading(element, load, signal)),
    );
    goOn(error, () => loading(element, load, signal), signal);
  } finally {
    element.removeAttribute("aria-busy");
  }
}

/** After an error of a server that is away, do something again once it is back. */
export function goOn(error, again, signal) {
  if (error.passes) serverIsBack(signal).then(again, () => {}); // left meanwhile
}

/** Names and figures beside each other. */
export function facts(pairs) {
  const rows = pairs.filter(([, figure]) => figure !== null && figure !== undefined);
  return h(
    "dl",
    { class: "facts" },
    rows.map(([name, figure]) => [h("dt", {}, name), h("dd", {}, figure)]),
  );
}

/** What is said when there is nothing yet. */
export function empty(title, text, ...actions) {
  return h(
    "div",
    { class: "empty" },
    h("h2", {}, title),
    h("p", { class: "muted" }, text),
    h("div", { class: "row" }, actions),
  );
}

/** A job's state as a badge; a map that was published and cannot be trusted is no success. */
export function stateBadge({ state, trusted }) {
  if (trusted === false) return h("span", { class: "badge bad" }, t`published, not trusted`);
  return h("span", { class: ["badge", STATES[state]] }, translated(state));
}

/** Whether a map can be relied on, as a badge; green only where something has checked it. */
export function trustBadge(map) {
  const [kind, text] = restsOnGivenPoses(map) ? ["", t`poses given`] : TRUST_BADGES[trustOf(map)];
  return h("span", { class: ["badge", kind] }, text);
}

/** A line that says that the server is away, and goes when it is back: `{element, show(error), hide()}`. */
export function lostNotice() {
  const element = h("p", { class: "notice warn", role: "alert", hidden: true });
  return {
    element,
    show: (error) => {
      fill(
        element,
        h("strong", {}, error.summary ?? error.message),
        " ",
        t`This page continues by itself when it is back.`,
      );
      element.hidden = false;
    },
    hide: () => (element.hidden = true),
  };
}
