/**
 * Errors of this package.
 *
 * ```text
 * AdverbError              code, status, detail
 * ├── TransportError       the server cannot be reached, or the connection broke
 * │   └── TimedOut         there is no answer in time
 * ├── DecodeError          bytes or JSON that do not follow the specification; `at` is the byte
 * ├── ArtifactError        a file that is not a verb, is damaged, or has a newer format
 * ├── StreamClosed         the stream is closed; see `closeCode`
 * └── ResponseError        the server answers with an error: `known`, `retryMs`, `channel`, …
 *     ├── NoAccess         401 and 403: unauthenticated, missing_scope
 *     ├── UnknownName      unknown_verb, unknown_adverb, …; `known` lists the names that exist
 *     ├── BadRequest       bad_request, invalid_request, out_of_range, bad_message, …
 *     ├── Conflict         version_conflict, read_only, already_refining, …
 *     ├── TooLarge         body_too_large, batch_too_large
 *     ├── Unavailable      not_ready, overloaded, too_many_requests, …; see `retryMs`
 *     └── ChannelError     of a stream: unknown_channel, skeleton_mismatch, …
 * ```
 */

/** Root of all errors of this package. */
export class AdverbError extends Error {
  override readonly name: string = "AdverbError";
  /** HTTP status; 0 where there is none. */
  readonly status: number = 0;
  /** Valid names or media types, where the given one does not exist. */
  readonly known: readonly string[] = [];
  /** Time after which the request may be repeated, ms; 0: not stated. */
  readonly retryMs: number = 0;

  constructor(
    /** Stable code of the error. */
    readonly code: string,
    readonly detail: string,
    options?: ErrorOptions,
  ) {
    super(detail, options);
  }
}

/** The server cannot be reached, or the connection broke. */
export class TransportError extends AdverbError {
  override readonly name: string = "TransportError";
  constructor(detail = "no response from the server", code = "offline", options?: ErrorOptions) {
    super(code, detail, options);
  }
}

/** There is no answer in time. */
export class TimedOut extends TransportError {
  override readonly name = "TimedOut";
  constructor(detail: string) {
    super(detail, "timed_out");
  }
}

/** Unreadable message or response; `at` is the offending byte. */
export class DecodeError extends AdverbError {
  override readonly name = "DecodeError";
  constructor(
    readonly at: number,
    problem: string,
  ) {
    super("decode", `byte ${at}: ${problem}`);
  }
}

/** A file that is not a verb, is damaged, or has a newer format. */
export class ArtifactError extends AdverbError {
  override readonly name = "ArtifactError";
  constructor(detail: string) {
    super("artifact", detail);
  }
}

/** The stream is closed and does not reconnect. */
export class StreamClosed extends AdverbError {
  override readonly name = "StreamClosed";
  constructor(
    detail: string,
    /** WebSocket close code; 0 where there is none. */
    readonly closeCode = 0,
  ) {
    super("stream_closed", detail);
  }
}

/** Further fields of an error response. */
export interface ResponseFields {
  /** Invalid fields of the body. */
  fieldErrors?: readonly { at: string; problem: string }[];
  /** The limit that is exceeded. */
  limit?: number | null;
  /** The scope that the key does not have. */
  scope?: string | null;
  /** Identifies the request in the server's log. */
  requestId?: string | null;
  /** Channel of a stream. */
  channel?: number | null;
}

/** The server answers a request or message with an error. */
export class ResponseError extends AdverbError {
  override readonly name: string = "ResponseError";
  readonly fieldErrors: readonly { at: string; problem: string }[];
  readonly limit: number | null;
  readonly scope: string | null;
  readonly requestId: string | null;
  readonly channel: number | null;

  constructor(
    override readonly status: number,
    code: string,
    detail: string,
    override readonly known: readonly string[] = [],
    override readonly retryMs = 0,
    fields: ResponseFields = {},
  ) {
    super(code, detail);
    this.fieldErrors = fields.fieldErrors ?? [];
    this.limit = fields.limit ?? null;
    this.scope = fields.scope ?? null;
    this.requestId = fields.requestId ?? null;
    this.channel = fields.channel ?? null;
  }
}

/** The key does not allow the request. */
export class NoAccess extends ResponseError {
  override readonly name = "NoAccess";
}
/** The name does not exist; `known` lists those that do. */
export class UnknownName extends ResponseError {
  override readonly name = "UnknownName";
}
/** The request is invalid. */
export class BadRequest extends ResponseError {
  override readonly name = "BadRequest";
}
/** The state of the server does not allow the request. */
export class Conflict extends ResponseError {
  override readonly name = "Conflict";
}
/** The request exceeds `limit`. */
export class TooLarge extends ResponseError {
  override readonly name = "TooLarge";
}
/** The server is temporarily unavailable; see `retryMs`. */
export class Unavailable extends ResponseError {
  override readonly name = "Unavailable";
}
/** The channel or session of a stream does not allow the message. */
export class ChannelError extends ResponseError {
  override readonly name = "ChannelError";
}

const CLASSES: readonly [typeof ResponseError, readonly string[]][] = [
  [NoAccess, ["unauthenticated", "missing_scope"]],
  [
    UnknownName,
    [
      ...["unknown_verb", "unknown_version", "unknown_adverb", "unknown_joint", "unknown_method", "unknown_space"],
      ...["unknown_map", "unknown_refinement", "unknown_draft"],
    ],
  ],
  [
    BadRequest,
    [
      ...["bad_request", "malformed_body", "invalid_request", "out_of_range", "bad_upload", "invalid_draft"],
      "bad_message",
    ],
  ],
  [
    Conflict,
    [
      ...["version_conflict", "revision_changed", "too_many_drafts", "draft_not_built", "no_source", "read_only"],
      "already_refining",
    ],
  ],
  [TooLarge, ["body_too_large", "batch_too_large"]],
  [Unavailable, ["not_ready", "overloaded", "too_many_requests", "too_many_streams", "store_unavailable"]],
  [ChannelError, ["unknown_channel", "channel_in_use", "too_many_channels", "skeleton_mismatch", "unknown_session"]],
];

const BY_CODE = new Map(CLASSES.flatMap(([kind, codes]) => codes.map((code) => [code, kind] as const)));

/** The error of a code of the server; a plain `ResponseError` where the code is unknown. */
export function responseError(
  status: number,
  code: string,
  detail: string,
  known: readonly string[] = [],
  retryMs = 0,
  fields: ResponseFields = {},
): ResponseError {
  return new (BY_CODE.get(code) ?? ResponseError)(status, code, detail, known, retryMs, fields);
}
