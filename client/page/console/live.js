// Who asks for poses now: in the room, and in a table.

import { path, rholoc } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { coordinates, decimal, percent, t } from "../shared/text.js";
import { length } from "./format.js";
import { Motions } from "./motions.js";

const STALE_S = 3; // after which somebody who asks no more is drawn faintly
const GONE_S = 30; // and after which not at all
const STILL_S = 0.5; // between two drawings while nobody moves
const TABLE_MS = 500;
const RECONNECT_MS = 1500;

/** A switch and what it shows, `{button, element}`; nothing is asked of the server until it is on. */
export function liveView(map, scene, signal) {
  let running = null;
  const said = h("p", { class: "small muted", role: "status" });
  const rows = h("tbody", {});
  const table = h(
    "table",
    {},
    h(
      "thead",
      {},
      h(
        "tr",
        {},
        [t`Who`, t`Pose`, "x, y, z", t`Uncertainty`, t`Asks`].map((text) => h("th", { scope: "col" }, text)),
      ),
    ),
    rows,
  );
  const scroll = h("div", { class: "scroll", tabindex: 0, role: "group", "aria-label": t`Live` }, table);
  const element = h("section", { class: "card stack", hidden: true }, h("h2", {}, t`Live`), said, scroll);
  const button = h("button", { type: "button", "aria-pressed": "false", onclick: () => toggle() }, t`Live`);

  function toggle() {
    if (running) running.abort();
    running = running ? null : new AbortController();
    button.setAttribute("aria-pressed", String(running !== null));
    element.hidden = running === null;
    scene.showRobots([]);
    if (running) follow(running.signal);
  }

  signal.addEventListener("abort", () => running?.abort());

  async function follow(stop) {
    const motions = new Motions();
    fill(rows);
    scroll.hidden = true;
    said.textContent = t`Nobody asks for poses at the moment.`;
    const timer = setInterval(() => tell(motions), TABLE_MS);
    let drawn = 0;
    const draw = () => {
      if (stop.aborted) return;
      const now = performance.now() / 1000;
      if (motions.moving(now) || now - drawn > STILL_S) {
        scene.showRobots(motions.now(now, STALE_S, GONE_S));
        drawn = now;
      }
      requestAnimationFrame(draw);
    };
    requestAnimationFrame(draw);
    stop.addEventListener("abort", () => clearInterval(timer));
    while (!stop.aborted) {
      try {
        for await (const answers of rholoc.events(path`v1/maps/${map.name}/live`, { signal: stop }))
          for (const answer of answers) motions.hear(answer, performance.now() / 1000);
      } catch (error) {
        if (stop.aborted) return;
        said.textContent = error.message;
      }
      await new Promise((resolve) => setTimeout(resolve, RECONNECT_MS));
    }
  }

  function tell(motions) {
    const now = performance.now() / 1000;
    const all = motions.all(now, GONE_S);
    scroll.hidden = all.length === 0;
    if (all.length) said.textContent = t`Asking for poses: ${all.length}.`;
    else said.textContent = t`Nobody asks for poses at the moment.`;
    fill(
      rows,
      all.map(({ asker, answer, hertz, age }) =>
        h(
          "tr",
          { class: age > STALE_S && "muted" },
          h("td", {}, asker || t`unknown`),
          h(
            "td",
            {},
            h(
              "span",
              { class: ["badge", answer.localized ? "good" : "bad"] },
              answer.localized ? percent(Math.min(answer.confidence, 0.99)) : t`none`,
            ),
          ),
          h("td", { class: "mono" }, answer.position ? coordinates(answer.position) : "–"),
          h("td", {}, answer.sigma_m === null ? "–" : length(answer.sigma_m, map.scale === "metric")),
          h("td", {}, age > STALE_S ? t`${Math.round(age)} s ago` : t`${decimal(hertz, 1)} a second`),
        ),
      ),
    );
  }

  return { button, element };
}
