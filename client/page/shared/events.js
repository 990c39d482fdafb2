// Server-sent events, with the key that EventSource cannot send.

import { request } from "./api.js";

/** What each event of a path holds, as JSON, until the connection ends. */
export async function* events(where, signal) {
  const response = await request(where, { signal, headers: { Accept: "text/event-stream" } });
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
