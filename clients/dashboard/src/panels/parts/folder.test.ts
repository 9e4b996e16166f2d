import { strFromU8, unzipSync } from "fflate";
import { expect, test } from "vitest";
import { readDroppedFolder, zipFolder } from "./folder";
import { readVerbName } from "./verb_name";

/** A dropped folder; its reader returns two entries per call. */
function folder(name: string, inside: Record<string, unknown>, path = `/${name}`): FileSystemDirectoryEntry {
  const entries = Object.entries(inside).map(([key, value]) => {
    const fullPath = `${path}/${key}`;
    if (typeof value !== "string") return folder(key, value as Record<string, unknown>, fullPath);
    const file = (found: (file: File) => void) => found(new File([value], key));
    return { name: key, fullPath, isDirectory: false, file };
  });
  const createReader = () => {
    const left = [...entries];
    return { readEntries: (found: (some: unknown[]) => void) => found(left.splice(0, 2)) };
  };
  return { name, fullPath: path, isDirectory: true, createReader } as unknown as FileSystemDirectoryEntry;
}

const SOURCE = {
  "verb.toml": 'name = "wave"\n',
  ".DS_Store": "x",
  motions: { "a.bvh": "A", "b.bvh": "B", "c.bvh": "C" },
};

test("a folder becomes a zip without hidden files, with paths relative to the folder", async () => {
  const zip = await zipFolder(await readDroppedFolder(folder("wave", { ...SOURCE, ".git": { config: "x" } })));
  expect(zip.name).toBe("wave.zip");
  const content = unzipSync(new Uint8Array(await zip.arrayBuffer()));
  const paths = ["wave/motions/a.bvh", "wave/motions/b.bvh", "wave/motions/c.bvh", "wave/verb.toml"];
  expect(Object.keys(content).sort()).toEqual(paths);
  expect(strFromU8(content["wave/motions/b.bvh"] ?? new Uint8Array())).toBe("B");
  expect(await readVerbName(zip)).toBe("wave");
});

test.each([
  ["empty", {}, /contains no verb.toml/],
  ["home", { deep: { "verb.toml": "" } }, /home contains no verb.toml/],
  [
    "much",
    { "verb.toml": "", ...Object.fromEntries([...Array(2001).keys()].map((k) => [`${k}`, "x"])) },
    /much is larger than 2000 files/,
  ],
])("the folder '%s' is rejected with a reason", async (name, inside, why) => {
  await expect(readDroppedFolder(folder(name, inside)).then(zipFolder)).rejects.toThrow(why);
});
