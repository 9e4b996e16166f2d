import { expect, test, vi } from "vitest";
import { SerialQueue } from "./serial_queue";

/** Tasks that are resolved by the test. */
function manualTasks(queue: SerialQueue) {
  const started: string[] = [];
  const resolve = new Map<string, (fails?: boolean) => void>();
  const add = (name: string) => {
    const task = () => {
      started.push(name);
      return new Promise<void>((done, failed) => {
        resolve.set(name, (fails) => (fails ? failed(new Error(name)) : done()));
      });
    };
    return { waits: queue.add(task), task };
  };
  return { started, resolve, add };
}

test("a task added while another runs waits for it, and none is lost", async () => {
  const { started, resolve, add } = manualTasks(new SerialQueue());
  expect(["a", "b", "c"].map((name) => add(name).waits)).toEqual([false, true, true]);
  expect(started).toEqual(["a"]);
  resolve.get("a")?.(true);
  await vi.waitFor(() => expect(started).toEqual(["a", "b"]));
  resolve.get("b")?.();
  await vi.waitFor(() => expect(started).toEqual(["a", "b", "c"]));
});

test("a removed task does not start", async () => {
  const queue = new SerialQueue();
  const { started, resolve, add } = manualTasks(queue);
  add("a");
  queue.remove(add("b").task);
  add("c");
  resolve.get("a")?.();
  await vi.waitFor(() => expect(started).toEqual(["a", "c"]));
});
