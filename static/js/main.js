/**
 * The dashboard: one newest state, drawn by everything else.
 * @module
 */

import { ApiError, request, useSession } from "./api.js";
import { Areas } from "./areas.js";
import { Calibration } from "./calibration.js";
import { Charts } from "./charts.js";
import { Controls } from "./controls.js";
import { byId, setText } from "./dom.js";
import { sentence } from "./guide.js";
import { Messages } from "./messages.js";
import { Overlay } from "./overlay.js";
import { Registration } from "./registration.js";
import { Status } from "./status.js";
import { StopButton } from "./stop.js";
import { Trials } from "./trial.js";
import { TwinPanel } from "./twin-panel.js";
import { TwinClient } from "./twin.js";
import { VideoView } from "./video.js";

/** @import { Snapshot, State, TwinEvent } from "./types.js" */
/** @import { Link } from "./socket.js" */

const REFRESH_MS = 100;
const STALE_MS = 500;
const ANNOUNCE_HANDOVER_S = 3;

/** @type {Snapshot | null} */ let snapshot = null;
/** @type {State | null} */ let state = null;
/** @type {Link} */ let link = "connecting";
let received_ms = -Infinity;
let receivedAt = "";
let signedOut = false;

const root = document.documentElement;
const banner = byId("banner", HTMLElement);
const announcement = byId("announcement", HTMLElement);
const placeholder = byId("video-placeholder", HTMLElement);

const messages = new Messages();
const status = new Status();
const charts = new Charts();
const calibration = new Calibration(messages);
const areas = new Areas(messages, () => show());
const trials = new Trials(messages);
const registration = new Registration(messages, () => drawOverlay());
const panel = new TwinPanel();
const twin = new TwinClient({ onSnapshot, onState, onEvent, onLink });
const stop = new StopButton(() => twin.ask("stop"), messages);
const controls = new Controls(
  (ask, area) => twin.ask(ask, area),
  () => areas.chosenId ?? undefined,
  messages,
);
const video = new VideoView(byId("video", HTMLCanvasElement), {
  onFirstFrame: () => {
    placeholder.hidden = true;
  },
});
const overlay = new Overlay(byId("overlay", HTMLCanvasElement), {
  onMark: (image_px) => areas.mark(image_px),
  onChoose: (id) => areas.choose(id),
});

/** @param {Snapshot} next */
function onSnapshot(next) {
  snapshot = next;
  signedOut = false;
  useSession(next.session);
  setText(byId("rig-name", HTMLElement), next.rig.name);
  byId("simulated", HTMLElement).hidden = !next.rig.simulated;
  setText(byId("vessel-name", HTMLElement), next.vessel.name);
  setText(byId("role", HTMLElement), next.role);
  calibration.reset(next);
  areas.reset(next);
  trials.reset(next);
  registration.reset(next);
  void panel.reset(next);
  if (next.state) onState(next.state);
}

/** @param {State} next */
function onState(next) {
  const changed = state?.mode !== next.mode;
  state = next;
  received_ms = performance.now();
  if (changed) show();
  panel.show(next);
  drawOverlay();
}

/** @param {TwinEvent} event */
function onEvent(event) {
  switch (event.event) {
    case "areas":
      areas.update(event.critical_areas);
      if (snapshot) void panel.reset(snapshot);
      break;
    case "handover":
      messages.say(event.by === "takeover" ? "You took over" : "Arrived: the robot is yours to steer", "info");
      break;
    case "contact":
      messages.say("The robot touched the wall", "warning");
      break;
    case "trial":
      if (event.mark === "reached") messages.say("Target reached", "info");
      break;
    case "calibration":
    case "registration":
      if (snapshot) snapshot = { ...snapshot, calibration: event.calibration };
      void registration.refresh();
      if (snapshot) void panel.reset(snapshot);
      break;
    case "fault":
      messages.say(event.reason, "warning");
      break;
  }
}

/** @param {Link} next @param {boolean} everOpened */
function onLink(next, everOpened) {
  link = next;
  if (next === "lost" && !everOpened) void probeSession();
  show();
}

/** A refused socket does not say why; the REST interface does. */
async function probeSession() {
  try {
    await request("GET", "/state");
    signedOut = false;
  } catch (error) {
    signedOut = error instanceof ApiError && (error.status === 401 || error.status === 403);
  }
}

function isFresh() {
  return performance.now() - received_ms <= STALE_MS;
}

function drawOverlay() {
  if (!snapshot || !state) return;
  overlay.show({
    snapshot,
    state,
    areas: areas.all,
    chosen: areas.chosenId,
    newEpsilon_um: areas.newEpsilon_um,
    outline_px: registration.outline_px,
    mayMark: snapshot.role === "operator" && isFresh(),
  });
}

/** Bring everything that a person reads up to date. */
function show() {
  const fresh = isFresh();
  const now_ms = performance.now();
  showBanner(fresh);
  status.showLinks(link, video.link, video.fps(now_ms));
  root.dataset.video = now_ms - video.last_ms <= STALE_MS ? "live" : "stale";
  charts.add(now_ms / 1000, fresh ? state : null);
  if (!snapshot || !state) return;
  controls.show({ role: snapshot.role, session: snapshot.session, state, chosen: areas.chosen, fresh });
  stop.confirm(fresh && state.mode === "STOP");
  status.showFigures(state);
  status.showRates(state);
  trials.show(state, now_ms / 1000, fresh);
  registration.show(state, fresh);
  calibration.show(state, fresh);
  const left_s = state.time_to_handover_s;
  const announced = fresh && state.mode === "AUTO" && left_s !== null && left_s <= ANNOUNCE_HANDOVER_S;
  announcement.hidden = !announced;
  if (announced) setText(announcement, `Hand-over in ${Math.max(1, Math.ceil(left_s))} s: be ready to steer`);
  drawOverlay();
}

/** @param {boolean} fresh */
function showBanner(fresh) {
  root.dataset.data = fresh ? "live" : "stale";
  banner.hidden = fresh;
  if (fresh) {
    receivedAt = new Date().toLocaleTimeString();
  } else if (signedOut) {
    setText(banner, "Not signed in. Open the address with the token that the server printed when it started.");
  } else if (state) {
    const does = link === "open" ? "The server is silent" : "Reconnecting";
    setText(banner, sentence(`No data since ${receivedAt}. ${does}. What you see is old`));
  } else {
    setText(banner, "Connecting to the server…");
  }
}

twin.start();
video.start();
show();
setInterval(show, REFRESH_MS);
