import { strFromU8, unzipSync } from "fflate";
import { expect, test } from "vitest";
import { filesIn, zipped } from "./folder";
import { nameInside } from "./verb_name";

/** A folder as a browser gives it when it is dropped: a reader tells some entries at a time, then none. */
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

test("a folder becomes a zip of all that is not hidden, by paths from the folder", async () => {
  const zip = await zipped(await filesIn(folder("wave", { ...SOURCE, ".git": { config: "x" } })));
  expect(zip.name).toBe("wave.zip");
  const content = unzipSync(new Uint8Array(await zip.arrayBuffer()));
  const paths = ["wave/motions/a.bvh", "wave/motions/b.bvh", "wave/motions/c.bvh", "wave/verb.toml"];
  expect(Object.keys(content).sort()).toEqual(paths);
  expect(strFromU8(content["wave/motions/b.bvh"] ?? new Uint8Array())).toBe("B");
  expect(await nameInside(zip)).toBe("wave");
});

test.each([
  ["empty", {}, /holds no verb.toml/],
  ["home", { deep: { "verb.toml": "" } }, /home holds no verb.toml/],
  [
    "much",
    { "verb.toml": "", ...Object.fromEntries([...Array(2001).keys()].map((k) => [`${k}`, "x"])) },
    /much is larger than 2000 files/,
  ],
])("the folder '%s' is no source, and it says why", async (name, inside, why) => {
  await expect(filesIn(folder(name, inside)).then(zipped)).rejects.toThrow(why);
});
