// The request behind an answer, as a program: what a developer copies.

/** What a request is written in. */
export const LANGUAGES = [
  ["curl", "curl"],
  ["python", "Python"],
  ["javascript", "JavaScript"],
];

/**
 * A program that posts a picture and prints the answer. `query` are the request's options without those that are empty,
 * `withKey` says whether the server asks for a key: the program then takes it from the environment.
 */
export function snippet(language, { url, map, query, file, type, withKey }) {
  return { curl, python, javascript }[language]({ url, map, query, file, type, withKey });
}

const addressOf = (url, map, query) => {
  const address = new URL(`v1/maps/${encodeURIComponent(map)}/localize`, url);
  for (const [name, value] of Object.entries(query)) address.searchParams.set(name, String(value));
  return address.href.replaceAll("%2C", ",");
};

const quoted = (text) => `'${text.replaceAll("'", "'\\''")}'`;

function curl({ url, map, query, file, type, withKey }) {
  return [
    "curl --fail-with-body \\",
    withKey && `  --header "Authorization: Bearer $RHOLOC_API_KEY" \\`,
    `  --header 'Content-Type: ${type}' \\`,
    `  --data-binary ${quoted(`@${file}`)} \\`,
    `  ${quoted(addressOf(url, map, query))}`,
  ]
    .filter(Boolean)
    .join("\n");
}

function python({ url, map, query, file, type, withKey }) {
  const headers = [`"Content-Type": ${JSON.stringify(type)}`];
  if (withKey) headers.push('"Authorization": f"Bearer {os.environ[\'RHOLOC_API_KEY\']}"');
  return [
    withKey && "import os",
    "from pathlib import Path",
    "",
    "import httpx",
    "",
    "answer = httpx.post(",
    `    ${JSON.stringify(addressOf(url, map, query))},`,
    `    content=Path(${JSON.stringify(file)}).read_bytes(),`,
    `    headers={${headers.join(", ")}},`,
    "    timeout=30,",
    ")",
    "answer.raise_for_status()",
    'print(answer.json()["pose"])',
  ]
    .filter((line) => typeof line === "string")
    .join("\n");
}

function javascript({ url, map, query, file, type, withKey }) {
  const headers = [`"Content-Type": ${JSON.stringify(type)}`];
  if (withKey) headers.push("Authorization: `Bearer ${process.env.RHOLOC_API_KEY}`");
  return [
    'import { readFile } from "node:fs/promises";',
    "",
    `const answer = await fetch(${JSON.stringify(addressOf(url, map, query))}, {`,
    '  method: "POST",',
    `  body: await readFile(${JSON.stringify(file)}),`,
    `  headers: { ${headers.join(", ")} },`,
    "});",
    "if (!answer.ok) throw new Error(await answer.text());",
    "console.log((await answer.json()).pose);",
  ].join("\n");
}
