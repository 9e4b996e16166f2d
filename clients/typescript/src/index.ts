/** Client of Adverb: REST, streams of poses, and verbs evaluated here. */

export { completeAdverbs, middleOf, namedAdverbs } from "./adverbs.js";
export { Emitter } from "./emitter.js";
export * from "./errors.js";
export { FORMAT } from "./evaluator/container.js";
export {
  type Blend,
  type EvaluatedPose,
  Evaluator,
  type EvaluatorMethod,
  type Instant,
} from "./evaluator/evaluator.js";
export { Evaluators } from "./evaluator/evaluators.js";
export type { StoredAdverb, StoredVerb } from "./evaluator/verb_file.js";
export type { components, paths } from "./generated/schema.js";
export { type MapFigures, type MappedVerb, Mapper, type MapperOptions, type RestJoint } from "./mapping/mapper.js";
export { Standing } from "./mapping/standing.js";
export * from "./math/kinematics.js";
export * from "./math/quaternion.js";
export * from "./rest/client.js";
export { eventData, follow } from "./rest/events.js";
export { bearer, errorOf, ifMatch, jsonBody, request, retryMs, type Send } from "./rest/request.js";
export type { Answer, CallOptions, Method, PathOf } from "./rest/routes.js";
export type * from "./schema.js";
export { alignRoot, Sequence } from "./sequence.js";
export { type Frame, JitterBuffer, type Sample } from "./stream/buffer.js";
export { Channel, type Outgoing } from "./stream/channel.js";
export { Clock, Lateness } from "./stream/clock.js";
export { Figure, type FigureOptions, type FigureSettings, type Pose, type SwitchOptions } from "./stream/figure.js";
export { FigureStream } from "./stream/figure_stream.js";
export { Link, type LinkEvents, now } from "./stream/link.js";
export type { Drawn, Motion, Seek, Shown } from "./stream/motion.js";
export { type Message, Protocol, type ProtocolEvents } from "./stream/protocol.js";
export { Reconnector, type Socket, type SocketEvents } from "./stream/reconnector.js";
export { type ConnectOptions, connect, Stream, type StreamEvents } from "./stream/stream.js";
export { type Connection, StreamCounters, type StreamStats } from "./stream/stream_stats.js";
export { viewMessage } from "./wire/client_messages.js";
export * from "./wire/decode.js";
export { readText, type ServerMessage } from "./wire/server_messages.js";
