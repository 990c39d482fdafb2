// The console: one page, whose address after the # says which part of it is shown.

import { keyButton, takeKeyOfLink } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { t, translatePage } from "../shared/text.js";
import { showCameras } from "./cameras.js";
import { showCorrections, showNaming } from "./correct.js";
import { showJob, showJobs } from "./jobs.js";
import { showKeys } from "./keys.js";
import { showMap } from "./map.js";
import { showMaps } from "./maps.js";
import { goOn, problem } from "./parts.js";
import { showRecording } from "./recording.js";
import { showRecordings } from "./recordings.js";
import { showRefusals } from "./refusals.js";
import { showSite, showSites } from "./sites.js";
import { showTry } from "./try.js";

const ROUTES = [
  [/^\/maps$/, t`Maps`, showMaps],
  [/^\/maps\/([^/]+)$/, t`Map`, showMap],
  [/^\/maps\/([^/]+)\/correct$/, t`Make it right`, showCorrections],
  [/^\/maps\/([^/]+)\/names$/, t`Name points`, showNaming],
  [/^\/maps\/([^/]+)\/refusals$/, t`Refused`, showRefusals],
  [/^\/try(?:\/([^/]+))?$/, t`Try it`, showTry],
  [/^\/jobs$/, t`Jobs`, showJobs],
  [/^\/jobs\/([^/]+)$/, t`Job`, showJob],
  [/^\/recordings$/, t`Recordings`, showRecordings],
  [/^\/recordings\/([^/]+)$/, t`Recording`, showRecording],
  [/^\/cameras$/, t`Cameras`, showCameras],
  [/^\/sites$/, t`Sites`, showSites],
  [/^\/sites\/([^/]+)$/, t`Site`, showSite],
  [/^\/keys$/, t`Keys`, showKeys],
];

let shown = new AbortController();

async function show() {
  shown.abort(); // what the view before still waits for
  shown = new AbortController();
  const { signal } = shown;
  const main = document.getElementById("content");
  const where = location.hash.slice(1).replace(/^\/?$/, "/maps");
  const found = ROUTES.map(([pattern, title, view]) => ({ title, view, match: where.match(pattern) })).find(
    ({ match }) => match,
  );
  for (const link of document.querySelectorAll("nav a")) {
    const part = link.getAttribute("href").replace("#", "");
    if (where === part || where.startsWith(`${part}/`)) {
      link.setAttribute("aria-current", "page");
      link.scrollIntoView({ block: "nearest", inline: "center" }); // on a phone the row is wider than the screen
    } else link.removeAttribute("aria-current");
  }
  scrollTo(0, 0);
  if (!found) {
    fill(main, h("div", { class: "empty" }, h("h1", {}, t`Nothing here`), h("a", { href: "#/maps" }, t`To the maps`)));
    return;
  }
  const name = found.match[1] === undefined ? undefined : decode(found.match[1]);
  document.title = `${name ?? found.title} – rholoc`;
  try {
    await found.view(main, name, signal);
  } catch (error) {
    if (signal.aborted) return;
    fill(main, problem(error, show));
    goOn(error, show, signal);
  }
}

function decode(text) {
  try {
    return decodeURIComponent(text);
  } catch {
    return text;
  }
}

addEventListener("hashchange", async () => {
  await show();
  document.getElementById("content").focus({ preventScroll: true });
});
takeKeyOfLink();
translatePage();
document.querySelector("header").append(keyButton());
show();
