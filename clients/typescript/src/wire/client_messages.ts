/** JSON text messages to the server that do not belong to one channel. */

/**
 * Message that sets viewpoint and byte budget of the connection; it replaces both.
 *
 * @param position m, +Y up; null: no viewpoint.
 * @param budgetKbps limit of pose messages, 1000 bit/s; null: unlimited.
 */
export function viewMessage(position: readonly [number, number, number] | null, budgetKbps: number | null): string {
  const [x, y, z] = position ?? [];
  return JSON.stringify({ op: "view", x, y, z, budget_kbps: budgetKbps ?? undefined });
}
