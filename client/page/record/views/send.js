// A recording on its way to the server, and its job there.

import { path, rholoc } from "../../shared/api.js";
import { action, fill, h } from "../../shared/dom.js";
import { doing, STAGES, timeLeft } from "../../shared/job_words.js";
import { Existing } from "../../shared/name_choice.js";
import { heard, percent, t } from "../../shared/text.js";
import { blamesPoints, inPlainWords, mistakesIn, nextForGood, Trust, whatToDo } from "../../shared/trust.js";
import { mapNames } from "../map_names.js";
import { archive } from "../recording.js";
import { State } from "../store.js";
import { size } from "./words.js";

/** Upload, going on where an earlier try stood; then the job, stage by stage. */
export async function sendView({ content, store, id }) {
  const recording = await store.recording(id);
  if (!recording) return void (location.hash = "#/");
  const page = new SendPage(recording);
  fill(content, page.element);
  const leaving = new AbortController();
  const change = async () => {
    await store.save({ ...recording, state: State.STOPPED, location: null });
    location.hash = `#/review/${id}`;
  };
  const stop = async () => {
    leaving.abort();
    await change();
  };
  if (recording.state !== State.UPLOADED) fill(page.actions, action(t`Cancel`, stop, "danger"));
  run(page, store, recording, leaving.signal).catch((error) => {
    if (!leaving.signal.aborted)
      page.failed(error, () => location.reload(), recording.state !== State.UPLOADED && change);
  });
  return () => leaving.abort();
}

async function run(page, store, recording, signal) {
  if (recording.state !== State.UPLOADED) {
    if (await wantsChoice(recording)) {
      await store.save({ ...recording, state: State.STOPPED });
      location.hash = `#/review/${recording.id}`;
      return;
    }
    recording = await send(page, store, recording, signal);
  }
  page.sent();
  const job = await rholoc.waitForJob(recording.job, {
    onChange: (job) => page.jobChanged(job),
    onLost: (error) => page.waiting(error, t`The page continues by itself when it can.`),
    signal,
  });
  page.ended(job, job.state === "published" ? await mistakesOf(job.map, signal) : []);
}

/** What the map's report says of mistakes in measured points; nothing where there is no asking it. */
async function mistakesOf(map, signal) {
  try {
    return mistakesIn((await rholoc.get(path`v1/maps/${map}/report`, { signal })).report);
  } catch {
    return [];
  }
}

/** Whether there is a map of that name, and nobody has said whether to keep it: the server was away then. */
async function wantsChoice({ location, map, asked }) {
  if (location || asked) return false;
  return Boolean((await mapNames())?.includes(map));
}

/** The description of the uploaded recording, whose parts are not needed any more. */
async function send(page, store, recording, signal) {
  const file = await archive(recording, await store.parts(recording.id));
  const { map, camera, location } = recording;
  const job = await rholoc.upload(file, {
    name: `${map}.zip`,
    map,
    kind: recording.kind ?? Existing.REPLACE,
    camera,
    location,
    tries: Infinity,
    onProgress: (sent) => page.sending(sent, file.size),
    onLocation: (location) => store.save(Object.assign(recording, { location })),
    onWaiting: (error) => page.waiting(error),
    signal,
  });
  fill(page.actions); // from here on the job is what can be cancelled
  const uploaded = { ...recording, state: State.UPLOADED, job };
  await store.dropParts(uploaded);
  return uploaded;
}

class SendPage {
  constructor(recording) {
    this.title = h("h1", {}, t`Sending`);
    this.bar = h("progress", { max: 1, value: "0", "aria-label": t`Progress` });
    this.text = h("p", { role: "status" }, t`Getting ready …`);
    this.notice = h("div", { class: "notice warn", role: "alert", hidden: true });
    this.stages = h(
      "ol",
      { class: "stages", hidden: true },
      Object.entries(STAGES).map(([stage, words]) => h("li", { "data-stage": stage }, words)),
    );
    this.actions = h("div", { class: "row" });
    this.closing = h("p", { class: "muted" }, t`You may close this page: sending continues when you open it again.`);
    this.element = h(
      "div",
      { class: "stack narrow" },
      this.title,
      h("p", { class: "muted" }, t`For the map ${recording.map}`),
      this.closing,
      this.bar,
      this.text,
      this.notice,
      this.stages,
      this.actions,
    );
  }

  sending(sent, whole) {
    this.notice.hidden = true;
    this.bar.value = sent / whole;
    this.text.textContent = t`${size(sent)} of ${size(whole)}, ${percent(sent / whole)}`;
  }

  waiting(error, comfort = t`Nothing is lost: sending continues by itself when it can.`) {
    if (!this.bar.value && !this.closing.hidden) this.text.textContent = t`Not started yet.`;
    this.notice.hidden = false;
    this.notice.className = "notice warn";
    const why = error.code !== "unreachable" && h("span", { class: "muted" }, error.summary);
    fill(this.notice, h("strong", {}, t`The server cannot be reached.`), " ", comfort, " ", why);
  }

  sent() {
    this.title.textContent = t`The server makes the map`;
    this.notice.hidden = true;
    this.closing.textContent = t`You may close this page: the server goes on by itself.`;
    this.stages.hidden = false;
    this.text.textContent = t`Sent. It is no longer needed on this phone.`;
    this.bar.removeAttribute("value");
  }

  jobChanged(job) {
    const { id, stage, progress, state } = job;
    this.notice.hidden = true;
    if (!this.actions.children.length)
      this.actions.append(action(t`Cancel`, () => rholoc.call("DELETE", path`v1/jobs/${id}`), "danger"));
    this.bar.value = progress;
    this.text.textContent =
      state === "queued" ? t`Waiting for its turn` : [doing(job), timeLeft(job)].filter(Boolean).join(" – ");
    const items = [...this.stages.children];
    const now = items.findIndex((item) => item.dataset.stage === stage);
    items.forEach((item, i) => {
      item.className = i < now || state === "published" ? "done" : i === now ? "now" : "";
      if (i === now) item.setAttribute("aria-current", "step");
      else item.removeAttribute("aria-current");
    });
  }

  /** `mistakes` are of measured points, which a map may have left out and be good without. */
  ended(job, mistakes) {
    const { state, error } = job;
    this.closing.hidden = true;
    const again = h("a", { class: "button", href: "#/" }, t`Record another`);
    if (state === "published") {
      this.published(job, mistakes, again);
      return;
    }
    this.title.textContent = state === "cancelled" ? t`The job was cancelled` : t`Mapping failed`;
    this.bar.hidden = true;
    this.text.hidden = true;
    this.stages.querySelector(".now")?.classList.add("failed");
    this.tell(error ?? { message: t`The server keeps the recording.`, hint: "" });
    fill(this.actions, h("a", { class: "button", href: "./#/jobs" }, t`All jobs`), again);
  }

  published({ map, recording, warnings }, mistakes, again) {
    const doubtful = warnings.length > 0;
    const why = warnings.join(" ");
    const where = encodeURIComponent(map);
    this.title.textContent = doubtful ? t`The map is made, but do not rely on it` : t`The map is ready`;
    this.text.textContent = whatToDo(doubtful ? Trust.NO : Trust.YES, mistakes, why) ?? nextForGood();
    const said = [...mistakes, ...warnings.map((one) => inPlainWords(one).plain)].join(" ");
    if (said) this.tell({ message: said, hint: "" });
    if (!doubtful && said) this.notice.className = "notice warn";
    const correctable = blamesPoints(mistakes, why);
    const link = (href, text, primary) => h("a", { class: ["button", primary && "primary"], href }, text);
    fill(
      this.actions,
      correctable && link(`./#/recordings/${recording}`, t`Correct the points`, doubtful),
      doubtful && link("#/", t`Walk again`, !correctable),
      link(`./#/maps/${where}`, t`See the map`, !doubtful),
      !doubtful && [link(`./#/try/${where}`, t`Try it`, false), again],
    );
  }

  failed(error, again, change) {
    this.title.textContent = t`It could not be sent`;
    this.closing.hidden = true;
    this.text.textContent = t`The recording is still on this phone.`;
    this.tell({ message: error.summary ?? error.message, hint: error.hint ?? "" });
    fill(
      this.actions,
      h("button", { class: "primary", onclick: again }, t`Try again`),
      change && h("button", { onclick: change }, t`Change it`),
      h("a", { class: "button", href: "#/" }, t`Later`),
    );
  }

  tell({ message, hint }) {
    this.notice.hidden = false;
    this.notice.className = "notice bad";
    fill(this.notice, h("strong", {}, heard(message)), " ", heard(hint));
  }
}
