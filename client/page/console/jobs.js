// Mapping jobs: how far they are, why they failed, cancelled and tried again.

import { path, rholoc } from "../shared/api.js";
import { action, fill, h, tell } from "../shared/dom.js";
import { doing, STAGES, timeLeft } from "../shared/job_words.js";
import { t, translated } from "../shared/text.js";
import { inPlainWords, nextForGood, Trust, whatToDo } from "../shared/trust.js";
import { duration, when } from "./format.js";
import { empty, facts, loading, lostNotice, skeletons, stateBadge } from "./parts.js";

const STAGES_OF_SITES = ["received", "links", "published"];
const PRIORITIES = ["high", "normal", "low"];
const LOOK_MS = 2000;
const ENDED = ["published", "failed", "cancelled"];

export async function showJobs(main, _, signal) {
  const list = h("ul", { class: "plain stack", "aria-label": t`Jobs` }, skeletons(3, "line"));
  const lost = lostNotice();
  fill(main, h("div", { class: "stack" }, h("h1", {}, t`Jobs`), lost.element, list));
  await loading(list, () => watchAll(list, lost, signal), signal);
}

/** Show all jobs as they change, for as long as the page is shown; a server that is away is waited for. */
async function watchAll(list, lost, signal) {
  let before;
  for (;;) {
    try {
      const { jobs } = await rholoc.get("v1/jobs", { signal });
      lost.hide();
      const now = JSON.stringify(jobs);
      if (now !== before) fill(list, jobs.length ? jobs.map(row) : h("li", {}, noJobs()));
      before = now;
    } catch (error) {
      if (signal.aborted || !error.passes) throw error;
      lost.show(error);
      if (before === undefined) fill(list);
    }
    list.removeAttribute("aria-busy");
    await new Promise((resolve) => setTimeout(resolve, LOOK_MS));
    signal.throwIfAborted();
  }
}

const noJobs = () =>
  empty(
    t`No jobs yet`,
    t`A job makes a map of each recording that is uploaded.`,
    h("a", { class: "button primary", href: "#/recordings" }, t`Upload a recording`),
  );

function row(job) {
  return h(
    "li",
    { class: "card stack" },
    h(
      "div",
      { class: "row spread" },
      h("h2", {}, h("a", { href: `#/jobs/${job.id}` }, nameOf(job))),
      h("span", { class: "row" }, stateBadge(job), h("span", { class: "muted small" }, when(job.created))),
    ),
    bar(job),
    h("p", { class: "muted small" }, [doing(job), timeLeft(job)].filter(Boolean).join(" – ")),
    job.warnings.map((warning) => h("p", { class: "small reason" }, inPlainWords(warning).plain)),
  );
}

const nameOf = (job) => (job.site ? t`Site ${job.site}` : job.map);

const bar = (job) =>
  h("progress", {
    max: 1,
    value: job.progress,
    class: job.state === "failed" && "failed",
    "aria-label": t`Progress of ${nameOf(job)}`,
  });

export async function showJob(main, id, signal) {
  const lost = lostNotice();
  const place = h("div", { class: "stack" }, skeletons(1, "panel"));
  fill(main, h("div", { class: "stack" }, lost.element, place));
  let shown = "";
  const hear = (job) => {
    lost.hide();
    const now = JSON.stringify(job);
    if (now !== shown) fill(place, overview(job));
    shown = now;
  };
  await rholoc.waitForJob(id, { onChange: hear, onLost: lost.show, signal });
}

function overview(job) {
  const again = () => dispatchEvent(new HashChangeEvent("hashchange"));
  return [
    h(
      "div",
      { class: "row spread" },
      h("h1", {}, job.site ? nameOf(job) : t`Map ${job.map}`),
      h(
        "div",
        { class: "row" },
        !ENDED.includes(job.state) && action(t`Cancel`, () => rholoc.call("DELETE", path`v1/jobs/${job.id}`), "danger"),
        ["failed", "cancelled"].includes(job.state) &&
          action(t`Try again`, async () => {
            await rholoc.call("POST", path`v1/jobs/${job.id}/retry`);
            again();
          }),
        job.state === "published" &&
          job.map &&
          h("a", { class: "button primary", href: `#/maps/${encodeURIComponent(job.map)}` }, t`To the map`),
      ),
    ),
    job.warnings.length > 0 && (job.site ? unplaced(job) : untrusted(job)),
    job.error &&
      h(
        "div",
        { class: "notice bad", role: "alert" },
        h("p", {}, h("strong", {}, job.error.message)),
        h("p", {}, job.error.hint),
      ),
    h(
      "div",
      { class: "card stack" },
      h(
        "div",
        { class: "row" },
        stateBadge(job),
        h("span", { role: "status" }, doing(job)),
        h("span", { class: "muted" }, timeLeft(job)),
      ),
      bar(job),
      !ENDED.includes(job.state) &&
        h("p", { class: "muted" }, t`You may close this page: the server goes on by itself.`),
      job.trusted && h("p", {}, nextForGood()),
      stages(job),
    ),
    facts([
      [t`Queued`, when(job.created)],
      [t`Took`, job.started && job.ended ? duration(job.ended - job.started) : null],
      [t`Attempts`, job.attempts],
      [t`Priority`, job.state === "queued" ? priorityField(job) : translated(job.priority)],
      [
        t`Recording`,
        job.recording
          ? h("a", { href: `#/recordings/${job.recording}` }, h("code", {}, job.recording.slice(0, 8)))
          : null,
      ],
    ]),
    h("h2", {}, t`Log`),
    job.log.length
      ? h("pre", { tabindex: 0, role: "log", "aria-label": t`Log` }, job.log.join("\n"))
      : h("p", { class: "muted" }, t`Nothing yet.`),
  ];
}

function untrusted(job) {
  return h(
    "div",
    { class: "notice bad stack", role: "alert" },
    h("p", {}, h("strong", {}, t`Do not rely on this map.`)),
    job.warnings.map((warning) => h("p", {}, inPlainWords(warning).plain)),
    h("p", {}, whatToDo(Trust.NO, [], job.warnings.join(" "))),
  );
}

function unplaced(job) {
  return h(
    "div",
    { class: "notice warn stack", role: "alert" },
    h("p", {}, h("strong", {}, t`Not all maps of the site are placed.`)),
    job.warnings.map((warning) => h("p", {}, warning)),
    h("p", {}, t`Give a link or a pose, or map what lies between them.`),
  );
}

/** A choice of how soon a job's turn comes, which takes effect at once. */
function priorityField(job) {
  const options = PRIORITIES.map((one) => h("option", { value: one, selected: one === job.priority }, translated(one)));
  const select = h("select", { "aria-label": t`Priority` }, options);
  select.addEventListener("change", async () => {
    try {
      await rholoc.call("PATCH", path`v1/jobs/${job.id}`, { body: { priority: select.value } });
    } catch (error) {
      select.value = job.priority;
      tell(error.message, "bad");
    }
  });
  return select;
}

function stages(job) {
  const all = job.site ? STAGES_OF_SITES : Object.keys(STAGES);
  const at = all.indexOf(job.stage);
  return h(
    "ol",
    { class: "stages" },
    all.map((stage, i) =>
      h(
        "li",
        {
          class: i < at || job.state === "published" ? "done" : i === at ? "now" : "",
          "aria-current": i === at ? "step" : null,
        },
        translated(stage),
      ),
    ),
  );
}
