import assert from "node:assert/strict";
import { readdirSync, readFileSync } from "node:fs";
import { join } from "node:path";
import { test } from "node:test";

import { heard, inGerman, key, translated } from "../../client/page/shared/text.js";
import { GERMAN, GERMAN_OF_SERVER } from "../../client/page/shared/texts.js";

const ROOT = new URL("../../client/page", import.meta.url).pathname;
const SPOKEN = ["queued", "running", "published", "failed", "cancelled", "received", "read", "keyframes", "features"];
const STAGES = ["poses", "observations", "densities", "report", "links"];
const LOOKED_UP = [...SPOKEN, ...STAGES, "high", "normal", "low", "accelerometer", "gyroscope"];
const VALUES = /\{\d\}/g;

/** The texts of all t`…` in a module, as they are looked up. */
function textsOf(source) {
  const found = [];
  for (const { index } of source.matchAll(/(?<![\w$.`])t`(?!…)/g)) {
    let [at, text, count] = [index + 2, "", 0];
    while (source[at] !== "`") {
      if (!source.startsWith("${", at)) {
        text += source[at++];
        continue;
      }
      text += `{${count++}}`;
      at = endOfValue(source, at + 2);
    }
    found.push(text);
  }
  return found;
}

function endOfValue(source, at) {
  for (let depth = 1; depth > 0; at++) {
    if (source[at] === "`") at = source.indexOf("`", at + 1);
    else if (source[at] === "{") depth++;
    else if (source[at] === "}") depth--;
  }
  return at;
}

function written() {
  const files = readdirSync(ROOT, { recursive: true, encoding: "utf8" });
  const code = files.filter((name) => name.endsWith(".js") && !name.endsWith("shared/text.js"));
  const texts = code.flatMap((name) => textsOf(readFileSync(join(ROOT, name), "utf8")));
  for (const name of ["index.html", "record/index.html"]) {
    const page = readFileSync(join(ROOT, name), "utf8");
    texts.push(...[...page.matchAll(/data-text>([^<\n]+)</g)].map((match) => match[1]));
    texts.push(...[...page.matchAll(/aria-label="([^"]+)" data-text/g)].map((match) => match[1]));
  }
  return new Set([...texts, ...LOOKED_UP]);
}

test("every text is in the file of texts, and no other", () => {
  const texts = written();
  assert.ok(texts.size > 300);
  assert.deepEqual([...texts].filter((text) => !(text in GERMAN)), []);
  assert.deepEqual(Object.keys(GERMAN).filter((text) => !texts.has(text)), []);
});

test("a translation has the values of its text", () => {
  for (const [text, german] of Object.entries(GERMAN)) {
    assert.deepEqual((german.match(VALUES) ?? []).sort(), (text.match(VALUES) ?? []).sort(), text);
  }
});

test("the server's percentages are written as the page's", () => {
  assert.equal(heard("They cover 74% of it, ±0.5%."), "They cover 74 % of it, ±0.5 %.");
});

test("values are put in, in any order, and not looked into", () => {
  assert.equal(key`from ${1} to ${2}`, "from {0} to {1}");
  assert.equal(translated("{1} before {0}", ["a", "{1}"]), "{1} before a");
});

test("the server still says what is translated of it, and figures get a comma", () => {
  const server = new URL("../../server/rholoc", import.meta.url).pathname;
  const files = readdirSync(server, { recursive: true, encoding: "utf8" }).filter((name) => name.endsWith(".py"));
  const client = new URL("../../client/js/client.js", import.meta.url).pathname;
  const all = [client, ...files.map((name) => join(server, name))].map((name) => readFileSync(name, "utf8"));
  const source = all.join("\n").replace(/"\s*f?"/g, "");
  for (const text of Object.keys(GERMAN_OF_SERVER))
    for (const piece of text.split(/\{\d\}|, | \(|\)?\.$/)) assert.ok(source.includes(piece), `${text}: ${piece}`);
  const said = "This picture does not show this map: 20 of 459 matches agree, no better than chance. Ask. The waypoint W2 is missed by 0.31 m.";
  assert.equal(
    inGerman(said),
    "Dieses Bild zeigt diese Karte nicht: 20 von 459 Zuordnungen stimmen überein, nicht mehr als durch Zufall. Ask. Der Wegpunkt W2 wird um 0,31 m verfehlt.",
  );
});
