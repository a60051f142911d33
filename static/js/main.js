/**
 * The dashboard: one newest state, drawn by everything else.
 * @module
 */

import { isSignedOut, useSession } from "./api.js";
import { Areas } from "./areas.js";
import { Calibration } from "./calibration.js";
import { Charts } from "./charts.js";
import { Controls } from "./controls.js";
import { byId, setText } from "./dom.js";
import { Gestures } from "./gestures.js";
import { hasControl } from "./guide.js";
import { Messages } from "./messages.js";
import { Overlay } from "./overlay.js";
import { PageHand } from "./page-hand.js";
import { Policies } from "./policies.js";
import { Presence } from "./presence.js";
import { Registration } from "./registration.js";
import { Siblings } from "./siblings.js";
import { Status } from "./status.js";
import { SteerGamepad } from "./steer-gamepad.js";
import { SteerKeys } from "./steer-keys.js";
import { StopButton } from "./stop.js";
import { StudyPanel } from "./study.js";
import { Tools } from "./tools.js";
import { Trials } from "./trial.js";
import { Training } from "./training.js";
import { trouble, TWIN_VERSION } from "./troubles.js";
import { TwinPanel } from "./twin-panel.js";
import { TwinClient } from "./twin.js";
import { VesselChoice } from "./vessel-choice.js";
import { VideoView } from "./video.js";
import { Viewport } from "./viewport.js";

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
const study = new StudyPanel(messages);
const registration = new Registration(messages, () => drawOverlay());
const vessel = new VesselChoice(messages);
const panel = new TwinPanel();
const policies = new Policies();
const training = new Training(messages, () => void policies.refresh());
const presence = new Presence(messages);
const siblings = new Siblings();
const twin = new TwinClient({ onSnapshot, onState, onEvent, onLink, onHandLease: (lease) => hand.onLease(lease) });
const stop = new StopButton(() => twin.ask("stop"), messages);
const controls = new Controls(
  (ask, area) => twin.ask(ask, area),
  () => areas.chosenId ?? undefined,
  messages,
  () => presence.giveBack(),
);
const picture = byId("video", HTMLCanvasElement);
const canvas = byId("overlay", HTMLCanvasElement);
const viewport = new Viewport(() => {
  picture.style.transform = viewport.transform;
  tools.showZoom(viewport.scale);
  overlay.request();
});
const tools = new Tools(viewport, messages, (tool) => {
  if (tool === "steer") hand.take();
  else if (hand.wanted) hand.give();
  canvas.focus({ preventScroll: true });
  show();
});
const hand = new PageHand(twin, {
  onBeat: (dt_s) => {
    keys.advance(dt_s);
    pad.advance(dt_s);
  },
  onChange: () => {
    root.dataset.hand = hand.holder ?? (hand.seated ? "open" : "none");
    overlay.request();
  },
  onLost: (why) => {
    tools.choose("mark");
    messages.say(`This page is not the hand: ${why}. Choose Steer to try again`, "warning");
  },
});
const keys = new SteerKeys(canvas, hand);
const pad = new SteerGamepad(hand, { onStop: () => stop.press(), onScale: () => tools.toggleScale() });
const overlay = new Overlay(canvas, viewport, () => gestures);
const gestures = new Gestures(canvas, viewport, hand, {
  scene: () => overlay.scene,
  tool: () => tools.tool,
  onDraft: (draft) => void areas.draw(draft),
  onChoose: (id) => areas.choose(id),
  onChange: () => overlay.request(),
});
const video = new VideoView(picture, {
  onFirstFrame: () => {
    placeholder.hidden = true;
  },
});
/** @param {Snapshot} next */
function onSnapshot(next) {
  const before = snapshot;
  snapshot = next;
  signedOut = false;
  if (next.v !== TWIN_VERSION) return show();
  useSession(next.session);
  if (before) void presence.reconnected(before.session, performance.now() - received_ms, next.vessel.name);
  siblings.introduce(next.seat);
  viewport.useCamera(next.camera);
  policies.reset(next);
  hand.reconnected();
  setText(byId("rig-name", HTMLElement), next.rig.name);
  byId("simulated", HTMLElement).hidden = !next.rig.simulated;
  setText(byId("vessel-name", HTMLElement), next.vessel.name);
  setText(byId("role", HTMLElement), next.role);
  calibration.reset(next);
  areas.reset(next);
  trials.reset(next);
  study.reset(next);
  registration.reset(next);
  vessel.reset(next);
  void training.reset(next);
  void panel.reset(next);
  if (next.state) onState(next.state);
}

/** @param {State} next */
function onState(next) {
  if (snapshot?.v !== TWIN_VERSION) return;
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
      areas.update(event.critical_areas, event.next);
      study.onNews();
      if (snapshot) void panel.reset(snapshot);
      break;
    case "handover":
      messages.report(event.by === "takeover" ? "You took over" : "Arrived: the robot is yours to steer", "info");
      break;
    case "contact":
      messages.report("The robot touched the wall", "warning");
      break;
    case "lease":
      controls.explainLease(event.reason ?? "");
      presence.explain(event.reason ?? "");
      break;
    case "trial":
      if (event.mark === "reached") messages.report("Target reached", "info");
      study.onMark(event.mark);
      break;
    case "calibration":
    case "registration":
      if (snapshot) snapshot = { ...snapshot, calibration: event.calibration };
      void registration.refresh();
      if (snapshot) void panel.reset(snapshot);
      break;
    case "fault":
      messages.report(event.reason, "warning");
      break;
    case "vessel_changing":
      presence.expect(event.vessel);
      break;
    case "recovered":
      messages.report(event.reason, "info");
      break;
  }
}

/** @param {Link} next @param {boolean} everOpened */
function onLink(next, everOpened) {
  link = next;
  if (next === "lost") hand.disconnected();
  if (next === "lost" && !everOpened) void probeSession();
  show();
}

async function probeSession() {
  signedOut = await isSignedOut();
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
    tool: tools.tool,
    mayDrive: hand.seated,
  });
}

/** Bring everything that a person reads up to date. */
function show() {
  const fresh = isFresh();
  const now_ms = performance.now();
  pad.watch();
  status.showLinks(link, video.link, video.fps(now_ms));
  const videoLive = now_ms - video.last_ms <= STALE_MS;
  root.dataset.video = videoLive ? "live" : "stale";
  showBanner(fresh, videoLive);
  charts.add(now_ms / 1000, fresh ? state : null);
  if (!snapshot || !state) return;
  areas.driving = state.mode === "AUTO";
  const { role, chief, seat: session } = snapshot;
  const elsewhere = siblings.include(state.lease.console);
  const known = { role, session, chief, elsewhere, state, chosen: areas.chosen, fresh };
  controls.show(known);
  presence.show(known);
  tools.show(known, hasControl(known));
  stop.confirm(fresh && state.mode === "STOP");
  status.showFigures(state);
  status.showRates(state);
  trials.show(state, now_ms / 1000, fresh);
  study.show(now_ms / 1000, fresh);
  registration.show(state, fresh);
  vessel.show(state, fresh);
  calibration.show(state, fresh);
  training.show(state, fresh);
  const left_s = state.time_to_handover_s;
  const announced = fresh && state.mode === "AUTO" && left_s !== null && left_s <= ANNOUNCE_HANDOVER_S;
  announcement.hidden = !announced;
  if (announced) setText(announcement, `Hand-over in ${Math.max(1, Math.ceil(left_s))} s: be ready to steer`);
  drawOverlay();
}

/** @param {boolean} fresh @param {boolean} videoLive */
function showBanner(fresh, videoLive) {
  root.dataset.data = fresh ? "live" : "stale";
  if (fresh) receivedAt = new Date().toLocaleTimeString();
  const text = trouble({ snapshot, state, fresh, signedOut, link, receivedAt, videoLive });
  banner.hidden = text === "";
  setText(banner, text);
}

twin.start();
void video.start();
show();
setInterval(show, REFRESH_MS);
