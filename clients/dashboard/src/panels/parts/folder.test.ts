import { strFromU8, unzipSync } from "fflate";
import { expect, test } from "vitest";
import { isSource, nameOf, readDropped, readDroppedFolder, zipClips, zipSource } from "./folder";
import { isZipOfClips, readVerbName } from "./verb_name";

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
  const zip = await zipSource(await readDroppedFolder(folder("wave", { ...SOURCE, ".git": { config: "x" } })));
  expect(zip.name).toBe("wave.zip");
  const content = unzipSync(new Uint8Array(await zip.arrayBuffer()));
  const paths = ["wave/motions/a.bvh", "wave/motions/b.bvh", "wave/motions/c.bvh", "wave/verb.toml"];
  expect(Object.keys(content).sort()).toEqual(paths);
  expect(strFromU8(content["wave/motions/b.bvh"] ?? new Uint8Array())).toBe("B");
  expect(await readVerbName(zip)).toBe("wave");
});

test("too many files are rejected with a reason", async () => {
  const inside = { "verb.toml": "", ...Object.fromEntries([...Array(2001).keys()].map((k) => [`${k}`, "x"])) };
  const files = await readDroppedFolder(folder("much", inside));
  await expect(zipSource(files)).rejects.toThrow(/much is larger than 2000 files/);
});

test("only a folder with verb.toml at its top is a source", async () => {
  const of = async (inside: Record<string, unknown>) => isSource(await readDroppedFolder(folder("home", inside)));
  expect(await of(SOURCE)).toBe(true);
  expect(await of({ deep: { "verb.toml": "" } })).toBe(false);
  expect(await of({ "a.bvh": "A" })).toBe(false);
});

test("clips of folders and loose clips lie at the top of the zip, with what belongs to them", async () => {
  const inside = { "a.bvh": "A", more: { "b.GLB": "B", "notes.txt": "x" }, "style.csv": "file,tired" };
  const loose = folder("top", { "c.npz": "C" }).createReader();
  const [entry] = await new Promise<FileSystemEntry[]>((found) => loose.readEntries(found as never));
  const files = await readDropped([folder("punches", inside), entry as FileSystemEntry]);
  const zip = await zipClips(files);
  const content = unzipSync(new Uint8Array(await zip.arrayBuffer()));
  expect(Object.keys(content).sort()).toEqual(["a.bvh", "b.GLB", "c.npz", "style.csv"]);
  expect(strFromU8(content["b.GLB"] ?? new Uint8Array())).toBe("B");
  expect(await isZipOfClips(zip)).toBe(true);
  expect(await isZipOfClips(await zipSource(await readDroppedFolder(folder("wave", SOURCE))))).toBe(false);
});

test("files without a clip, and two clips of one name, are rejected with a reason", async () => {
  await expect(readDroppedFolder(folder("empty", { "notes.txt": "x" })).then(zipClips)).rejects.toThrow(/No clips/);
  const twice = { one: { "a.bvh": "A" }, two: { "a.bvh": "B" } };
  await expect(readDroppedFolder(folder("two", twice)).then(zipClips)).rejects.toThrow(/Two files are named a.bvh/);
});

test.each([
  [["punches/a.bvh", "punches/b.bvh"], "punches"],
  [["My Punches 2/a.bvh"], "my-punches-2"],
  [["PunchLeft.bvh", "PunchRight.bvh"], "punch"],
  [["a.bvh", "b.bvh"], "draft"],
  [["01_05.bvh", "01_06.bvh"], "draft"],
])("clips %j are named %s", (paths, name) => {
  expect(nameOf(paths)).toBe(name);
});
