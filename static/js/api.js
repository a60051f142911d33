/**
 * The REST interface. The cookie that was set when the page was opened signs every request.
 * @module
 */

const BASE = "/api/v1";
const TIMEOUT_MS = 5000;

/** @type {string | null} */
let session = null;

/** Name this page towards the rig's lease from now on. @param {string} name As the snapshot says. */
export function useSession(name) {
  session = name;
}

/** The server's refusal, or the network's. */
export class ApiError extends Error {
  /**
   * @param {string} message One sentence for a person.
   * @param {string} code Stable reason.
   * @param {number} status HTTP status; 0 when nothing answered.
   */
  constructor(message, code, status) {
    super(message);
    this.code = code;
    this.status = status;
  }
}

/**
 * Send one request and return the answer's JSON (null for an empty answer).
 * @param {"GET" | "POST" | "PUT" | "DELETE"} method
 * @param {string} path Below /api/v1.
 * @param {unknown} [body] Sent as JSON; a file as it is.
 * @param {{as?: string, timeout_ms?: number}} [how] As another session than this page's own; waiting longer.
 * @returns {Promise<unknown>}
 * @throws {ApiError}
 */
export async function request(method, path, body, { as = session ?? "", timeout_ms = TIMEOUT_MS } = {}) {
  /** @type {Response} */
  let response;
  try {
    response = await fetch(BASE + path, {
      method,
      headers: {
        ...(body === undefined ? {} : { "content-type": body instanceof Blob ? body.type : "application/json" }),
        ...(as === "" ? {} : { "x-mrnav-session": as }),
      },
      body: body === undefined ? null : body instanceof Blob ? body : JSON.stringify(body),
      cache: "no-store",
      // So that what was asked last gets out of a page that closes; a file is too large for that.
      keepalive: !(body instanceof Blob),
      signal: AbortSignal.timeout(timeout_ms),
    });
  } catch {
    throw new ApiError("The server does not answer.", "network", 0);
  }
  const text = await response.text().catch(() => "");
  if (response.ok) return text ? JSON.parse(text) : null;
  throw refusal(response.status, text);
}

/**
 * @param {number} status
 * @param {string} text Body, application/problem+json if the server wrote it.
 * @returns {ApiError}
 */
function refusal(status, text) {
  try {
    const problem = JSON.parse(text);
    const detail = typeof problem.detail === "string" ? problem.detail : problem.title;
    return new ApiError(detail || `The server refused (${status}).`, problem.code ?? "refused", status);
  } catch {
    return new ApiError(`The server refused (${status}).`, "refused", status);
  }
}

/**
 * What to tell a person about a failed call.
 * @param {unknown} error
 * @returns {string}
 */
export function explain(error) {
  return error instanceof Error ? error.message : String(error);
}

/**
 * Whether the server no longer knows who this is: a refused socket does not say why, the REST interface does.
 * @returns {Promise<boolean>}
 */
export async function isSignedOut() {
  try {
    await request("GET", "/state");
    return false;
  } catch (error) {
    return error instanceof ApiError && (error.status === 401 || error.status === 403);
  }
}
