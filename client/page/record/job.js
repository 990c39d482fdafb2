// A mapping job, followed until it ends.

import { ApiError, get, path, request } from "../shared/api.js";

const ENDED = new Set(["published", "failed", "cancelled"]);
const PAUSE_MS = 1500;

/**
 * Hear of every change of a job; resolves to the job as it ended. Its events are listened to where the server sends
 * them, else it is asked for every now and then; while there is no connection, this waits for one, and `lost` hears why.
 * @throws {ApiError} when there is no such job; AbortError.
 */
export async function followJob(id, hear, signal, lost = (_error) => {}) {
  for (;;) {
    try {
      for await (const job of jobEvents(id, signal)) {
        hear(job);
        if (ENDED.has(job.state)) return job;
      }
      const job = await get(path`v1/jobs/${id}`, { signal });
      hear(job);
      if (ENDED.has(job.state)) return job;
    } catch (error) {
      if (!(error instanceof ApiError || error instanceof TypeError)) throw error;
      if (error instanceof ApiError && error.code !== "unreachable" && error.status < 500) throw error;
      if (error instanceof ApiError) lost(error);
    }
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
    signal?.throwIfAborted();
  }
}

/** What the server says of a job as it changes, until the connection ends. */
async function* jobEvents(id, signal) {
  let response;
  try {
    response = await request(path`v1/jobs/${id}/events`, { signal, headers: { Accept: "text/event-stream" } });
  } catch (error) {
    if (error.code === "unknown_route") return;
    throw error;
  }
  let text = "";
  const reader = response.body.pipeThrough(new TextDecoderStream()).getReader();
  for (let piece = await reader.read(); !piece.done; piece = await reader.read()) {
    text += piece.value.replaceAll("\r", "");
    const blocks = text.split("\n\n");
    text = blocks.pop();
    for (const block of blocks) {
      const data = [...block.matchAll(/^data: ?(.*)$/gm)].map((match) => match[1]).join("\n");
      if (data) yield JSON.parse(data);
    }
  }
}
