/** A fetched sequence that can be sampled at any phase. */

import { DecodeError } from "./errors.js";
import { heading, multiply, slerp } from "./math/quaternion.js";
import { layoutOf, poseLength, type RecordHead, readPose, readRecordHead } from "./wire/decode.js";

export class Sequence {
  readonly version: number;
  private readonly heads: RecordHead[] = [];
  private readonly poses: Float32Array;

  /** From the binary response of `POST …/sequence`; throws `DecodeError`. */
  constructor(
    content: ArrayBuffer,
    private readonly joints: number,
  ) {
    const layout = layoutOf("f32", joints, 36 + 16 * joints);
    const view = new DataView(content);
    const count = content.byteLength / layout.recordBytes;
    if (!Number.isInteger(count) || count < 1)
      throw new DecodeError(content.byteLength, `not a whole number of records of ${layout.recordBytes} bytes`);
    this.poses = new Float32Array(count * poseLength(joints));
    for (let k = 0; k < count; k++) {
      this.heads.push(readRecordHead(view, k * layout.recordBytes, layout));
      readPose(view, k * layout.recordBytes, layout, this.poses, k * poseLength(joints));
    }
    this.version = this.first.version;
  }

  get first(): RecordHead {
    return this.heads[0] as RecordHead;
  }

  /** Write the pose at a phase to `out`; returns its head. */
  at(phase: number, out: Float32Array): RecordHead {
    const stride = poseLength(this.joints);
    let k = this.heads.findIndex((head) => head.phase > phase);
    if (k < 0) k = this.heads.length;
    const [i, j] = [Math.max(k - 1, 0), Math.min(k, this.heads.length - 1)];
    const [a, b] = [this.heads[i] as RecordHead, this.heads[j] as RecordHead];
    const share = b.phase > a.phase ? Math.min(Math.max((phase - a.phase) / (b.phase - a.phase), 0), 1) : 0;
    for (let c = 0; c < 3; c++)
      out[c] = (1 - share) * (this.poses[i * stride + c] as number) + share * (this.poses[j * stride + c] as number);
    for (let c = 3; c < stride; c += 4) slerp(out, c, this.poses, i * stride + c, this.poses, j * stride + c, share);
    return { ...a, phase, timeS: a.timeS + share * (b.timeS - a.timeS) };
  }
}

/** Move a pose to the position and heading of another, since a fetched cycle does not travel on. */
export function alignRoot(pose: Float32Array, other: Float32Array): void {
  const angle = heading(other, 3) - heading(pose, 3);
  const turn = [0, Math.sin(angle / 2), 0, Math.cos(angle / 2)];
  multiply(pose, 3, turn, 0, pose, 3);
  pose[0] = other[0] as number;
  pose[2] = other[2] as number;
}
