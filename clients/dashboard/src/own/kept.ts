/** Figures that this browser keeps: files and corrections of their mapping, by name. */

const DATABASE = "adverb";
const STORE = "figures";

export interface KeptFigure {
  name: string;
  file: Blob;
  /** Joints of the figure by joints of a verb; empty: left out. */
  joints: Record<string, string>;
}

export async function keep(figure: KeptFigure): Promise<void> {
  await run("readwrite", (store) => store.put(figure));
}

/** A figure by name; undefined where this browser has none. */
export async function kept(name: string): Promise<KeptFigure | undefined> {
  return run("readonly", (store) => store.get(name) as IDBRequest<KeptFigure | undefined>);
}

export async function forget(name: string): Promise<void> {
  await run("readwrite", (store) => store.delete(name));
}

async function run<Value>(
  mode: IDBTransactionMode,
  work: (store: IDBObjectStore) => IDBRequest<Value>,
): Promise<Value> {
  const database = await settled(opening());
  try {
    const transaction = database.transaction(STORE, mode);
    const [value] = await Promise.all([settled(work(transaction.objectStore(STORE))), completed(transaction)]);
    return value;
  } finally {
    database.close();
  }
}

/** Wait until a transaction is stored: a request that succeeded can still be lost with the page. */
function completed(transaction: IDBTransaction): Promise<void> {
  return new Promise((resolve, reject) => {
    transaction.oncomplete = () => resolve();
    transaction.onabort = () => reject(transaction.error ?? new Error("This browser keeps no figures."));
  });
}

function opening(): IDBOpenDBRequest {
  const request = indexedDB.open(DATABASE, 1);
  request.onupgradeneeded = () => request.result.createObjectStore(STORE, { keyPath: "name" });
  return request;
}

function settled<Value>(request: IDBRequest<Value>): Promise<Value> {
  return new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error ?? new Error("This browser keeps no figures."));
  });
}
