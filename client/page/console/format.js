// Figures and times for people.

import { decimal, language, when as localTime, t } from "../shared/text.js";

const UNITS = ["bytes", "kB", "MB", "GB"];
/** 416937 → "417 kB" */
export function bytes(count) {
  const power = Math.min(UNITS.length - 1, count < 1000 ? 0 : Math.floor(Math.log10(count) / 3));
  return `${Number((count / 1000 ** power).toPrecision(3)).toLocaleString(language)} ${UNITS[power]}`;
}

/** A count with thousands apart. */
export const count = (value) => value.toLocaleString(language);

/** An ISO time, or seconds since the epoch → local date and time. */
export const when = (time) => localTime(typeof time === "number" ? 1000 * time : time);

/** Seconds → "2 min 5 s" */
export function duration(seconds) {
  const whole = Math.round(seconds);
  return whole < 60 ? `${whole} s` : `${Math.floor(whole / 60)} min ${whole % 60} s`;
}

/** A length for people: centimetres below a metre; bare units where the map is not metric. */
export function length(value, metric = true) {
  if (!metric) return Number(value.toPrecision(2)).toLocaleString(language) + t` units`;
  return value < 1 ? `${decimal(100 * value, value < 0.1 ? 1 : 0)} cm` : `${decimal(value, 2)} m`;
}

/** The files of a recording in a few words. */
export function fileNames({ files }) {
  const [first, ...more] = files;
  return more.length ? t`${first} and ${more.length} more` : first;
}
