// What people read, in their language: t`There is no map ${name}.` gives the sentence of texts.js, or itself.

import { GERMAN, GERMAN_OF_SERVER } from "./texts.js";

/** The language that the page speaks: the browser's where there are texts in it, else English. */
export const language = globalThis.navigator?.language?.toLowerCase().startsWith("de") ? "de" : "en";

/** A number with so many decimals, as the page's language writes it. */
export const decimal = (value, digits = 0) =>
  value.toLocaleString(language, { minimumFractionDigits: digits, maximumFractionDigits: digits, useGrouping: false });

/** Coordinates beside each other; where a comma is in them, semicolons are between them. */
export const coordinates = (values, digits = 2) =>
  values.map((value) => decimal(value, digits)).join(language === "de" ? "; " : ", ");

/** A part of one as a percentage. */
export const percent = (share) => `${Math.round(100 * share)} %`;

/** An ISO time, or milliseconds since the epoch, as a local date and time. */
export function when(time) {
  const date = new Date(time);
  return Number.isNaN(date.getTime())
    ? String(time)
    : date.toLocaleString(language === "de" ? "de" : "en-GB", { dateStyle: "medium", timeStyle: "short" });
}

const texts = language === "de" ? GERMAN : {};

/** A sentence with its values put in; a template is looked up with {0}, {1} … in place of the values. */
export function t(parts, ...values) {
  return translated(key(parts), values);
}

/** A sentence that is not written where it is shown: of a table, or of the page's markup. */
export function translated(text, values = []) {
  return (texts[text] ?? text).replace(/\{(\d)\}/g, (_, i) => String(values[i]));
}

/** What the server said in English, in the page's language as far as its sentences are known, percentages as the page's. */
export const heard = (text) => (language === "de" ? inGerman(text) : text).replace(/(\d)%/g, "$1 %");

/** Sentences of `GERMAN_OF_SERVER` within a text in German, their figures with a comma. */
export function inGerman(text) {
  return Object.entries(GERMAN_OF_SERVER).reduce((whole, [english, german]) => {
    const pattern = english.replace(/[.*+?^$()|[\]\\]/g, "\\$&").replace(/\{\d\}/g, "(.+?)");
    return whole.replace(new RegExp(pattern, "g"), (_, ...found) =>
      german.replace(/\{(\d)\}/g, (_, i) => found[i].replace(/(\d)\.(\d)/g, "$1,$2")),
    );
  }, text);
}

/** What a template is called in texts.js. */
export function key(parts) {
  return parts.slice(1).reduce((whole, part, i) => `${whole}{${i}}${part}`, parts[0]);
}

/** Say the page's language, and put its markup into it: the texts and labels of elements with `data-text`. */
export function translatePage() {
  document.documentElement.lang = language;
  for (const element of document.querySelectorAll("[data-text]")) {
    if (element.hasAttribute("aria-label"))
      element.setAttribute("aria-label", translated(element.getAttribute("aria-label")));
    if (!element.children.length) element.textContent = translated(element.textContent);
  }
}
