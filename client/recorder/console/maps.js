// The maps that are served.

import { call, get, objectUrl, path } from "../shared/api.js";
import { ask, fill, h } from "../shared/dom.js";
import { bytes, count, length, when } from "./format.js";
import { action, empty, facts, field, loading, nameField, page, skeletons, tell } from "./parts.js";

export async function showMaps(main, _, signal) {
  const list = h("ul", { class: "cards", "aria-label": "Maps" }, skeletons(3, "map-card"));
  const reload = () => loading(list, () => fillList(list, signal), signal);
  const upload = action("Upload a map", () => uploadMap(reload));
  fill(
    main,
    page(
      "Maps",
      h("div", { class: "row" }, upload, h("a", { class: "button primary", href: "record" }, "Record a walk")),
      list,
    ),
  );
  await reload();
}

async function fillList(list, signal) {
  const { maps, unreadable } = await get("v1/maps", { signal });
  const broken = Object.entries(unreadable).map(([name, why]) =>
    h("li", { class: "notice bad" }, h("strong", {}, name), ": ", why),
  );
  if (!maps.length && !broken.length) {
    fill(
      list,
      h(
        "li",
        { class: "whole-row" },
        empty(
          "No maps yet",
          "One walk through a room with a phone makes a map.",
          h("a", { class: "button primary", href: "record" }, "Record a walk"),
          h("a", { class: "button", href: "#/recordings" }, "Upload a recording"),
        ),
      ),
    );
    return;
  }
  fill(
    list,
    maps.map((map) => card(map, signal)),
    broken,
  );
}

function card(map, signal) {
  const picture = h("img", { alt: "", width: 1200, height: 900 });
  objectUrl(path`v1/maps/${map.name}/preview.png`, { signal })
    .then((address) => {
      picture.addEventListener("load", () => URL.revokeObjectURL(address), { once: true });
      picture.src = address;
    })
    .catch(() => picture.classList.add("missing"));
  return h(
    "li",
    { class: "card map-card" },
    h("div", { class: "picture" }, picture),
    h("h2", {}, h("a", { href: `#/maps/${encodeURIComponent(map.name)}` }, map.name)),
    facts([
      ["Expected error", map.expected_error_m === null ? "not measured" : length(map.expected_error_m)],
      ["Size", `${count(map.landmarks)} landmarks, ${bytes(map.size_bytes)}`],
      ["Made", when(map.created)],
    ]),
    h(
      "div",
      { class: "row" },
      map.scale === "arbitrary" && h("span", { class: "badge warn" }, "no unit of length"),
      !map.upright && h("span", { class: "badge warn" }, "not upright"),
      h("span", { class: "badge" }, `version ${map.version}`),
      h("span", { class: "badge" }, map.features),
    ),
  );
}

async function uploadMap(reload) {
  const file = h("input", { type: "file", name: "file", accept: ".rho,.csv", required: true });
  const name = nameField();
  file.addEventListener("change", () => (name.value ||= file.files[0]?.name.replace(/\.(rho|csv)$/, "") ?? ""));
  const done = await ask(
    "Upload a map",
    [field("File (.rho or .csv)", file), field("Name", name)],
    h("button", { class: "primary" }, "Upload"),
    (form) =>
      call("PUT", path`v1/maps/${form.get("name")}`, {
        body: file.files[0],
        headers: { "Content-Type": "application/octet-stream" },
      }),
  );
  if (done) {
    tell("The map is uploaded.");
    await reload();
  }
}
