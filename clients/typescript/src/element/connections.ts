/** Connections that elements share. */

import type { Stream } from "../stream/stream.js";

/** A connection and the number of elements that use it. */
export interface Connection {
  readonly name: string;
  readonly stream: Promise<Stream>;
  users: number;
}

/** Connections by server and key. One that failed is not given to further elements. */
export class Connections {
  private readonly known = new Map<string, Connection>();

  constructor(private readonly connect: (server: string, key: string) => Promise<Stream>) {}

  /** The connection of a server and key; each element releases it once. */
  acquire(server: string, key: string): Connection {
    const name = `${server}\n${key}`;
    const found = this.known.get(name) ?? { name, stream: this.connect(server, key), users: 0 };
    found.users++;
    this.known.set(name, found);
    found.stream.catch(() => this.forget(found));
    return found;
  }

  release(connection: Connection): void {
    if (--connection.users > 0) return;
    this.forget(connection);
    connection.stream.then((stream) => stream.close()).catch(() => {});
  }

  private forget(connection: Connection): void {
    if (this.known.get(connection.name) === connection) this.known.delete(connection.name);
  }
}
