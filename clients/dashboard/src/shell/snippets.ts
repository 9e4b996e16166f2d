/** Requests for the motion in view, as text for a shell or a program. */

import type { SequenceRequest } from "../types";

export interface Wanted {
  /** Address of the server, without a slash at the end. */
  readonly server: string;
  readonly verb: string;
  readonly request: SequenceRequest;
  /** Whether requests need a key. It is read from the environment and never part of the text. */
  readonly keyed: boolean;
}

export const LANGUAGES = ["curl", "Python", "JavaScript", "C#"] as const;
export type Language = (typeof LANGUAGES)[number];

const WRITERS: Record<Language, (wanted: Wanted) => string> = {
  curl,
  Python: python,
  JavaScript: javascript,
  "C#": csharp,
};

export function snippet(language: Language, wanted: Wanted): string {
  return WRITERS[language](wanted);
}

function curl({ server, verb, request, keyed }: Wanted): string {
  return [
    `curl -sf -X POST ${quoted(address(server, verb))} \\`,
    ...(keyed ? ['  -H "Authorization: Bearer $ADVERB_KEY" \\'] : []),
    "  -H 'Content-Type: application/json' -H 'Accept: model/gltf-binary' \\",
    `  -d ${quoted(JSON.stringify({ ...request, mannequin: true }))} -o ${quoted(`${verb}.glb`)}`,
    "",
  ].join("\n");
}

/** Single quotes for a POSIX shell. */
function quoted(text: string): string {
  return `'${text.replaceAll("'", "'\\''")}'`;
}

function python({ server, verb, request, keyed }: Wanted): string {
  const { adverbs, ...options } = request;
  const named = Object.entries(options).map(([name, value]) => `, ${name}=${JSON.stringify(value)}`);
  return [
    ...(keyed ? ["import os", ""] : []),
    "from adverb_client import Client  # pip install clients/python",
    "",
    `with Client(${JSON.stringify(server)}${keyed ? ', api_key=os.environ["ADVERB_KEY"]' : ""}) as client:`,
    `    motion = client.sequence(${JSON.stringify(verb)}, ${JSON.stringify(adverbs)}${named.join("")})`,
    "print(motion.rotations.shape, motion.duration_s)",
    "",
  ].join("\n");
}

function javascript({ server, verb, request, keyed }: Wanted): string {
  const key = keyed ? ['    Authorization: "Bearer " + process.env.ADVERB_KEY,'] : [];
  return [
    `const response = await fetch(${JSON.stringify(address(server, verb))}, {`,
    '  method: "POST",',
    "  headers: {",
    '    "Content-Type": "application/json",',
    ...key,
    "  },",
    `  body: JSON.stringify(${JSON.stringify(request)}),`,
    "});",
    "const motion = await response.json();",
    "console.log(motion.frames, motion.duration);",
    "",
  ].join("\n");
}

/** Statements for an asynchronous method, with `using System; using System.Collections.Generic; using Adverb;`. */
function csharp({ server, verb, request, keyed }: Wanted): string {
  const goal = Object.entries(request.adverbs ?? {}).map(([name, value]) => `{ ${JSON.stringify(name)}, ${value} }`);
  const key = keyed ? ', Environment.GetEnvironmentVariable("ADVERB_KEY")' : "";
  const options = request.method ? `, options: new PoseOptions { Method = ${JSON.stringify(request.method)} }` : "";
  return [
    `using (var client = new AdverbClient(${JSON.stringify(server)}${key})) // clients/csharp/Adverb.cs`,
    "{",
    `    var goal = new Dictionary<string, double> { ${goal.join(", ")} };`,
    `    WireRecord[] motion = await client.SequenceAsync(${JSON.stringify(verb)}, goal, fps: ${request.fps}${options});`,
    '    Console.WriteLine(motion.Length + " frames");',
    "}",
    "",
  ].join("\n");
}

function address(server: string, verb: string): string {
  return `${server}/v1/verbs/${encodeURIComponent(verb)}/sequence`;
}
