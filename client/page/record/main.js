// The recorder: which view is shown, and what they share.

import { keyButton, takeKeyOfLink } from "../shared/api.js";
import { fill, h } from "../shared/dom.js";
import { t, translatePage } from "../shared/text.js";
import { missing, Problem } from "./problem.js";
import { Store } from "./store.js";
import { homeView } from "./views/home.js";
import { liveView } from "./views/live.js";
import { reviewView } from "./views/review.js";
import { sendView } from "./views/send.js";

const VIEWS = { "": homeView, next: homeView, live: liveView, review: reviewView, send: sendView };
const content = document.getElementById("content");
let leave = () => {};

/** Show the view of the address: `#/`, `#/next/MAP/X,Y,DEGREES`, `#/live`, `#/review/ID`, `#/send/ID`. A view gives back what ends it. */
async function show(store) {
  const [name, id, place] = location.hash.replace(/^#\/?/, "").split("/");
  leave();
  leave = () => {};
  try {
    leave = (await (VIEWS[name] ?? homeView)({ content, store, id, place })) ?? leave;
  } catch (error) {
    fill(content, problemNotice(error), h("p", {}, h("a", { href: "#/" }, t`Back`)));
  }
}

function problemNotice(error) {
  return h(
    "div",
    { class: "notice bad", role: "alert" },
    h("h1", {}, error.title ?? t`Something went wrong.`),
    h("p", {}, error.advice ?? error.message),
  );
}

async function start() {
  const lack = missing();
  if (lack?.code === "no-database") throw lack;
  const store = await Store.open().catch((error) => {
    throw new Problem(
      "no-database",
      t`This browser stores nothing for this page.`,
      t`Leave private browsing and try again. (${error.message})`,
    );
  });
  await navigator.storage?.persist?.();
  addEventListener("hashchange", () => show(store));
  await show(store);
}

takeKeyOfLink(true);
translatePage();
document.querySelector("header").append(keyButton());
start().catch((error) => fill(content, problemNotice(error)));
if (window.isSecureContext)
  navigator.serviceWorker?.register("web/record/service-worker.js", { scope: "record" }).catch(() => {});
