// Recordings: uploaded, and what is kept of them.

import { path, rholoc } from "../shared/api.js";
import { action, ask, busy, fill, h, tell } from "../shared/dom.js";
import { field, mapNameOf, nameChoice } from "../shared/name_choice.js";
import { t } from "../shared/text.js";
import { bytes, duration, fileNames, when } from "./format.js";
import { listTools } from "./list_tools.js";
import { empty, loading, page, skeletons, stateBadge } from "./parts.js";
import { thumbnail } from "./recording.js";

const FILES_SHOWN = 3;
const ORDERS = [
  ["created", t`the newest first`, (a, b) => b.created - a.created],
  ["name", t`by file name`, (a, b) => a.files[0].localeCompare(b.files[0])],
  ["size", t`the largest first`, (a, b) => b.size_bytes - a.size_bytes],
  ["length", t`the longest first`, (a, b) => (b.content?.length_s ?? 0) - (a.content?.length_s ?? 0)],
];

export async function showRecordings(main, _, signal) {
  const list = h("div", {}, skeletons(3, "line"));
  let found = { recordings: [], jobs: [] };
  const show = () => fillList(list, found, tools, reload, signal);
  const tools = listTools({
    orders: ORDERS,
    groups: [["map", t`by map`, (one) => [...new Set(jobsOf(one, found.jobs).map((job) => job.map))]]],
    textOf: (one) => searched(one, found.jobs),
    changed: show,
  });
  const reload = () =>
    loading(
      list,
      async () => {
        const [{ recordings }, { jobs }] = await Promise.all(
          ["v1/recordings", "v1/jobs"].map((at) => rholoc.get(at, { signal })),
        );
        found = { recordings, jobs };
        show();
      },
      signal,
    );
  fill(
    main,
    page(
      t`Recordings`,
      h("a", { class: "button", href: "record" }, t`Record a walk`),
      uploadForm(signal),
      h("h2", {}, t`Stored recordings`),
      tools.element,
      list,
    ),
  );
  await reload();
}

/** What a recording is found by: its files, and the maps that it went into. */
const searched = (recording, jobs) =>
  [...recording.files, ...jobsOf(recording, jobs).map((job) => job.map), recording.id].join(" ");

const jobsOf = (recording, jobs) => jobs.filter((job) => job.recording === recording.id);

function uploadForm(signal) {
  const file = h("input", { type: "file", name: "file", required: true, accept: "video/*,.zip,.mkv" });
  const name = nameChoice({});
  file.addEventListener(
    "change",
    () => name.value || name.suggest(mapNameOf((file.files[0]?.name ?? "").replace(/\.[^.]*$/, ""))),
  );
  const names = rholoc.get("v1/maps", { signal }).then(({ maps }) => name.know(maps.map((map) => map.name)));
  names.catch(() => {}); // the list below says so
  const bar = h("progress", { max: 1, value: 0, "aria-label": t`Upload` });
  const standing = h("p", { class: "muted small", role: "status" }, t`A video, or a recording as a ZIP file.`);
  const button = h("button", { class: "primary" }, t`Upload`);
  return h(
    "form",
    {
      class: "card stack",
      onsubmit: (event) => {
        event.preventDefault();
        const [blob] = file.files;
        const onProgress = (sent) => {
          bar.value = blob.size ? sent / blob.size : 1;
          standing.textContent = t`${bytes(sent)} of ${bytes(blob.size)}`;
        };
        const onWaiting = ({ message }) => (standing.textContent = t`${message} It continues by itself.`);
        const what = { name: blob.name, map: name.value, kind: name.kind };
        busy(button, async () => {
          try {
            const job = await rholoc.upload(blob, { ...what, tries: Infinity, onProgress, onWaiting, signal });
            location.hash = `#/jobs/${job}`;
          } catch (error) {
            if (!signal.aborted) tell(error.message, "bad");
          }
        });
      },
    },
    h("h2", {}, t`Upload a walk`),
    h("div", { class: "form" }, field(t`Recording`, file), name.element),
    h("div", { class: "row" }, button),
    bar,
    standing,
  );
}

function fillList(place, { recordings, jobs }, tools, reload, signal) {
  if (!recordings.length) {
    fill(
      place,
      empty(
        t`No recordings yet`,
        t`They are kept after their map is made, so that a job can be tried again and other maps can learn them.`,
        h("a", { class: "button primary", href: "record" }, t`Record a walk`),
      ),
    );
    return;
  }
  const heads = [t`Picture`, t`Files`, t`Length`, t`Map and job`, t`Size`, t`Uploaded`, t`Actions`];
  fill(
    place,
    h(
      "div",
      { class: "scroll", tabindex: 0, role: "group", "aria-label": t`Recordings` },
      h(
        "table",
        {},
        h(
          "thead",
          {},
          h(
            "tr",
            {},
            heads.map((text) => h("th", { scope: "col" }, text)),
          ),
        ),
        h(
          "tbody",
          {},
          tools
            .chosen(recordings)
            .map(({ title, items }) => [
              title !== null && h("tr", {}, h("th", { scope: "rowgroup", colspan: heads.length }, title)),
              items.map((one) => row(one, jobsOf(one, jobs), reload, signal)),
            ]),
        ),
      ),
    ),
  );
}

function row(recording, jobs, reload, signal) {
  const { files, content } = recording;
  return h(
    "tr",
    {},
    h("td", {}, thumbnail(recording, signal)),
    h(
      "td",
      {},
      h(
        "a",
        { href: `#/recordings/${recording.id}` },
        files.slice(0, FILES_SHOWN).join(", "),
        files.length > FILES_SHOWN && t` and ${files.length - FILES_SHOWN} more`,
      ),
      h("br"),
      h("code", { class: "muted", title: recording.id }, recording.id.slice(0, 8)),
    ),
    h("td", {}, content && content.length_s !== null ? duration(content.length_s) : "–"),
    h(
      "td",
      {},
      jobs.map((job) => h("div", { class: "row" }, h("a", { href: `#/jobs/${job.id}` }, job.map), stateBadge(job))),
    ),
    h("td", {}, bytes(recording.size_bytes)),
    h("td", {}, when(recording.created)),
    h(
      "td",
      {},
      action(t`Delete`, () => remove(recording, reload), "danger"),
    ),
  );
}

async function remove(recording, reload) {
  const done = await ask(
    t`Delete the recording?`,
    h("p", {}, t`${fileNames(recording)}, ${bytes(recording.size_bytes)}. Maps made of it stay.`),
    h("button", { class: "danger primary" }, t`Delete`),
    () => rholoc.call("DELETE", path`v1/recordings/${recording.id}`),
  );
  if (done) await reload();
}
