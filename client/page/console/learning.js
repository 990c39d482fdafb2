// What a map learns from those who use it, in a few sentences.

import { percent, t } from "../shared/text.js";
import { count, when } from "./format.js";

/** From how many queries a map learns, when it last did, and what came of it; null where nobody lets it learn. */
export function learningText({ learns, queries, fewest, last, latest, job }) {
  const said = [];
  if (learns) said.push(t`It learns from those who use it: ${count(queries)} queries are kept.`);
  else if (queries) said.push(t`It no longer learns from those who use it; ${count(queries)} queries are kept.`);
  if (learns && queries < fewest) said.push(t`From ${fewest} on it can learn.`);
  if (job) said.push(t`It is learning now.`);
  if (latest?.state === "failed") said.push(t`On ${when(latest.ended)} it learned nothing: ${latest.error?.message}`);
  if (last) said.push(...lessons(last, latest));
  return said.length ? said.join(" ") : null;
}

function lessons({ version, features_new: fresh, queries: tested }, latest) {
  const done =
    latest?.state === "published"
      ? t`It last learned on ${when(latest.ended)}: ${count(fresh)} landmarks are new, ${count(tested.features_forgotten)} are gone.`
      : t`With version ${version} it learned: ${count(fresh)} landmarks are new, ${count(tested.features_forgotten)} are gone.`;
  const better = t`Of queries held back for a test it placed ${percent(tested.recall_before)} before and ${percent(tested.recall_after)} after.`;
  return [done, better];
}
