import { readFileSync } from "node:fs";
import { deflateRawSync } from "node:zlib";
import { describe, expect, test } from "vitest";
import { readVerbName } from "./verb_name";

interface Member {
  path: string;
  text: string;
  packed?: boolean;
}

/** A zip without checksums. */
function zip(members: readonly Member[], comment = ""): Blob {
  const parts: Buffer[] = [];
  const directory: Buffer[] = [];
  let at = 0;
  for (const { path, text, packed = false } of members) {
    const name = Buffer.from(path);
    const full = Buffer.from(text);
    const bytes = packed ? deflateRawSync(full) : full;
    const shared = Buffer.alloc(26);
    shared.writeUInt16LE(packed ? 8 : 0, 4);
    shared.writeUInt32LE(bytes.length, 14);
    shared.writeUInt32LE(full.length, 18);
    shared.writeUInt16LE(name.length, 22);
    const end = Buffer.alloc(14);
    end.writeUInt32LE(at, 10);
    directory.push(Buffer.from("PK\x01\x02\x14\x00"), shared, end, name);
    const local = Buffer.concat([Buffer.from("PK\x03\x04"), shared, name, bytes]);
    parts.push(local);
    at += local.length;
  }
  const size = directory.reduce((sum, { length }) => sum + length, 0);
  const tail = Buffer.alloc(22);
  tail.write("PK\x05\x06", "latin1");
  tail.writeUInt16LE(members.length, 8);
  tail.writeUInt16LE(members.length, 10);
  tail.writeUInt32LE(size, 12);
  tail.writeUInt32LE(at, 16);
  tail.writeUInt16LE(comment.length, 20);
  return new Blob([Buffer.concat([...parts, ...directory, tail, Buffer.from(comment)])]);
}

const TOML = '# a verb\nname = "punch"\nfps = 30.0\n\n[[adverb]]\nname = "x"\n';

describe("a zip", () => {
  test.each([true, false])("contains the verb's name (compressed: %s)", async (packed) => {
    const members = [
      { path: "punch/low.bvh", text: "HIERARCHY", packed },
      { path: "punch/verb.toml", text: TOML, packed },
    ];
    expect(await readVerbName(zip(members))).toBe("punch");
  });

  test("may have a trailing comment and no folder", async () => {
    expect(await readVerbName(zip([{ path: "verb.toml", text: TOML }], "made by hand"))).toBe("punch");
  });

  test("__MACOSX entries are ignored", async () => {
    const members = [
      { path: "__MACOSX/verb.toml", text: 'name = "wrong"' },
      { path: "a/verb.toml", text: "name = 'kick'" },
    ];
    expect(await readVerbName(zip(members))).toBe("kick");
  });

  test("the name of an adverb is not the verb's name", async () => {
    expect(await readVerbName(zip([{ path: "verb.toml", text: '[[adverb]]\nname = "x"\n' }]))).toBeNull();
  });

  test("without verb.toml or truncated it has no name", async () => {
    const whole = zip([{ path: "walk.bvh", text: "HIERARCHY" }]);
    expect(await readVerbName(whole)).toBeNull();
    expect(await readVerbName(whole.slice(0, whole.size - 30))).toBeNull();
  });
});

describe("an artifact", () => {
  test("contains the verb's name", async () => {
    const bytes = readFileSync(new URL("../../../../../verbs/library/arm3.verb", import.meta.url));
    expect(await readVerbName(new Blob([bytes]))).toBe("arm3");
  });

  test("an invalid file has no name", async () => {
    const endless = Buffer.alloc(64, 0xff);
    expect(await readVerbName(new Blob([endless]))).toBeNull();
    expect(await readVerbName(new Blob(["junk"]))).toBeNull();
  });
});
