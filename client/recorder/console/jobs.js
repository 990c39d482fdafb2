// Mapping jobs: how far they are, why they failed, cancelled and tried again.

import { call, get, path } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { followJob } from "../record/job.js";
import { ago, duration, when } from "./format.js";
import { action, empty, facts, loading, skeletons, stateBadge } from "./parts.js";

const STAGES = [
  "received",
  "read",
  "keyframes",
  "features",
  "poses",
  "observations",
  "densities",
  "report",
  "published",
];
const LOOK_MS = 2000;
const ENDED = ["published", "failed", "cancelled"];

export async function showJobs(main, _, signal) {
  const list = h("ul", { class: "plain stack", "aria-label": "Jobs" }, skeletons(3, "line"));
  fill(main, h("div", { class: "stack" }, h("h1", {}, "Jobs"), list));
  await loading(list, () => watchAll(list, signal), signal);
}

async function watchAll(list, signal) {
  let before;
  for (;;) {
    const { jobs } = await get("v1/jobs", { signal });
    const now = JSON.stringify(jobs);
    if (now !== before) {
      fill(
        list,
        jobs.length
          ? jobs.map(row)
          : h(
              "li",
              {},
              empty(
                "No jobs yet",
                "A job makes a map of each recording that is uploaded.",
                h("a", { class: "button primary", href: "#/recordings" }, "Upload a recording"),
              ),
            ),
      );
      before = now;
      list.removeAttribute("aria-busy");
    }
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    signal.throwIfAborted();
  }
}

function row(job) {
  return h(
    "li",
    { class: "card stack" },
    h(
      "div",
      { class: "row spread" },
      h("h2", {}, h("a", { href: `#/jobs/${job.id}` }, job.map)),
      h("span", { class: "row" }, stateBadge(job.state), h("span", { class: "muted small" }, ago(job.created))),
    ),
    bar(job),
    h("p", { class: "muted small" }, job.error?.message ?? job.message),
  );
}

const bar = (job) => h("progress", { max: 1, value: job.progress, "aria-label": `Progress of ${job.map}` });

export async function showJob(main, id, signal) {
  const place = h("div", { class: "stack" }, skeletons(1, "panel"));
  fill(main, place);
  let shown = "";
  const hear = (job) => {
    const now = JSON.stringify(job);
    if (now !== shown) fill(place, overview(job));
    shown = now;
  };
  hear(await get(path`v1/jobs/${id}`, { signal }));
  await followJob(id, hear, signal);
}

function overview(job) {
  const again = () => dispatchEvent(new HashChangeEvent("hashchange"));
  return [
    h(
      "div",
      { class: "row spread" },
      h("h1", {}, "Map ", job.map),
      h(
        "div",
        { class: "row" },
        !ENDED.includes(job.state) && action("Cancel", () => call("DELETE", path`v1/jobs/${job.id}`), "danger"),
        ["failed", "cancelled"].includes(job.state) &&
          action("Try again", async () => {
            await call("POST", path`v1/jobs/${job.id}/retry`);
            again();
          }),
        job.state === "published" &&
          h("a", { class: "button primary", href: `#/maps/${encodeURIComponent(job.map)}` }, "To the map"),
      ),
    ),
    h(
      "div",
      { class: "card stack" },
      h("div", { class: "row" }, stateBadge(job.state), h("span", { role: "status" }, job.message)),
      bar(job),
      stages(job),
    ),
    job.warnings.map((warning) => h("p", { class: "notice warn" }, warning)),
    job.error &&
      h(
        "div",
        { class: "notice bad", role: "alert" },
        h("p", {}, h("strong", {}, job.error.message)),
        h("p", {}, job.error.hint),
      ),
    facts([
      ["Queued", when(job.created)],
      ["Took", job.started && job.ended ? duration(job.ended - job.started) : null],
      ["Attempts", job.attempts],
      ["Recording", h("code", {}, job.recording)],
    ]),
    h("h2", {}, "Log"),
    job.log.length
      ? h("pre", { tabindex: 0, role: "log", "aria-label": "Log" }, job.log.join("\n"))
      : h("p", { class: "muted" }, "Nothing yet."),
  ];
}

function stages(job) {
  const at = STAGES.indexOf(job.stage);
  return h(
    "ol",
    { class: "stages" },
    STAGES.map((stage, i) =>
      h(
        "li",
        {
          class: i < at || job.state === "published" ? "done" : i === at ? "now" : "",
          "aria-current": i === at ? "step" : null,
        },
        stage,
      ),
    ),
  );
}
