/**
 * The headset page: what is missing, the way in, and everything that a visit needs of the rig.
 * @module
 */

/// <reference types="webxr" />

import { WebGLRenderer } from "three";
import { explain, isSignedOut, request, useSession } from "../api.js";
import { byId, icon, make, setText } from "../dom.js";
import { Messages } from "../messages.js";
import { StopButton } from "../stop.js";
import { TwinClient } from "../twin.js";
import { Cockpit } from "./cockpit.js";
import { HandSender } from "./hand-sender.js";
import { assess, look } from "./support.js";
import { Visit } from "./visit.js";

/** @import { Ask, CriticalArea, HandLease, Snapshot, State, Triple, TwinEvent } from "../types.js" */
/** @import { Link } from "../socket.js" */
/** @import { Hit } from "./cockpit.js" */
/** @import { Command } from "./menu.js" */
/** @import { Found } from "./support.js" */

const CLIENT = "headset page";
const NEW_EPSILON_UM = 500;
const STALE_MS = 500;
const SHOW_MS = 100;
const MESSAGE_MS = 6000;

const root = document.documentElement;
const enter = byId("enter", HTMLButtonElement);
// A machine that draws by software tests everything but the drawing.
const draw = new URLSearchParams(location.search).get("draw") !== "0";

/** @type {Omit<Found, "link" | "signedOut" | "role">} */
let browser = { secure: isSecureContext, webxr: false, immersion: null, webgl: true };
let looked = false;
/** @type {Link} */ let link = "connecting";
let signedOut = false;
/** @type {Snapshot | null} */ let snapshot = null;
/** @type {State | null} */ let state = null;
let received_ms = -Infinity;
/** @type {CriticalArea[]} */ let areas = [];
let seated = false;
/** Whether the seat was lost by silence: the next message brings it back. */
let silent = false;
let tookLease = false;
let marking = false;
let seen = false;
let told = "";
let told_ms = -Infinity;
let answered_ms = -Infinity;
/** @type {Visit | null} */ let visit = null;
/** @type {Cockpit | null} */ let cockpit = null;

const messages = new Messages();
const twin = new TwinClient({ onSnapshot, onState, onEvent, onHandLease, onLink });
const stop = new StopButton(() => twin.ask("stop"), messages);
const sender = new HandSender((message) => (seated || silent) && twin.sendHand(message));

/** @param {Snapshot} next */
function onSnapshot(next) {
  snapshot = next;
  signedOut = false;
  useSession(next.session);
  setText(byId("rig-name", HTMLElement), next.rig.name);
  byId("simulated", HTMLElement).hidden = !next.rig.simulated;
  const side_cm = next.vessel.size_px * next.vessel.um_per_px * 1e-4;
  for (const scale of [10, 20, 30]) {
    setText(byId(`size-${scale}`, HTMLElement), `${scale} ×, ${Math.round(side_cm * scale)} cm`);
  }
  areas = next.critical_areas;
  void cockpit?.load(next, scaleOfTwin());
  if (next.state) onState(next.state);
  // The link is new: the seat went with the old one.
  seated = silent = false;
  if (visit) void sitDown();
}

/** @param {State} next */
function onState(next) {
  state = next;
  received_ms = performance.now();
  cockpit?.show(next);
}

/** @param {TwinEvent} event */
function onEvent(event) {
  if (event.event === "areas") areas = event.critical_areas;
  if (event.event === "registration" || event.event === "calibration") {
    if (snapshot) snapshot = { ...snapshot, calibration: event.calibration };
  }
  if (snapshot && ["areas", "registration", "calibration"].includes(event.event)) {
    void cockpit?.load(snapshot, scaleOfTwin());
  }
  // On the page, the dashboard's events would only distract from the way in.
  if (!visit) return;
  if (event.event === "handover") report(event.by === "takeover" ? "You took over" : "Arrived: yours to steer");
  if (event.event === "contact") report("The robot touched the wall");
  if (event.event === "fault") report(event.reason);
}

/** @param {HandLease} lease */
function onHandLease(lease) {
  seated = lease.lease;
  silent = lease.code === "silent";
  if (seated) return;
  visit?.openClutch();
  if (lease.code !== "given_back") say(lease.message);
}

/** @param {Link} next @param {boolean} everOpened */
function onLink(next, everOpened) {
  link = next;
  if (next === "lost") {
    seated = silent = false;
    visit?.openClutch();
    if (!everOpened) void probeSession();
  }
}

async function probeSession() {
  signedOut = await isSignedOut();
}

/** Answer the operator, in the room or on the page. @param {string} text */
function say(text) {
  told = text;
  told_ms = answered_ms = performance.now();
  if (!visit) messages.say(text, "warning");
}

/** Tell what happened by itself; an answer is read first. @param {string} text */
function report(text) {
  if (performance.now() - answered_ms < MESSAGE_MS) return;
  told = text;
  told_ms = performance.now();
}

function scaleOfTwin() {
  const chosen = document.querySelector("input[name=scale]:checked");
  return chosen instanceof HTMLInputElement ? Number(chosen.value) : 20;
}

/** Become the rig's hand, and its console too if nobody is. */
async function sitDown() {
  if (snapshot?.role !== "operator") return;
  twin.takeHand(CLIENT, "webxr");
  if (state?.lease.console) return;
  try {
    await request("POST", "/lease", { client: CLIENT });
    tookLease = true;
  } catch (error) {
    say(explain(error));
  }
}

/** Give back what was taken. */
async function getUp() {
  twin.giveHand();
  seated = silent = false;
  if (tookLease) await request("DELETE", "/lease").catch(() => undefined);
  tookLease = false;
}

async function begin() {
  if (!navigator.xr || !browser.immersion || !snapshot || visit) return;
  messages.clear();
  enter.disabled = true;
  try {
    const session = await navigator.xr.requestSession(browser.immersion, {
      optionalFeatures: ["hand-tracking"],
    });
    cockpit ??= makeCockpit();
    cockpit.closeRoom(browser.immersion === "immersive-vr");
    const renderer = new WebGLRenderer({ antialias: true, alpha: true });
    renderer.xr.enabled = true;
    visit = new Visit(session, renderer, cockpit, { snapshot: () => snapshot, marking: newEpsilon_m, onMark, onHand, onFrame }, draw);
    session.addEventListener("end", () => leave(renderer));
    await cockpit.load(snapshot, scaleOfTwin());
    await visit.start();
    root.dataset.xr = "inside";
    sender.start();
    await sitDown();
  } catch (error) {
    await visit?.end();
    visit = null;
    messages.say(`The headset did not let the page in: ${explain(error)}`, "warning");
  }
  show();
}

/** The session has ended, by whomever. @param {WebGLRenderer} renderer */
function leave(renderer) {
  visit = null;
  marking = false;
  seen = false;
  sender.stop();
  void getUp();
  renderer.setAnimationLoop(null);
  renderer.dispose();
  root.dataset.xr = "outside";
  show();
}

function makeCockpit() {
  const made = new Cockpit(onPress);
  made.microscope.start();
  return made;
}

function newEpsilon_m() {
  return marking ? NEW_EPSILON_UM * 1e-6 : null;
}

/** @param {Command} command */
function onPress(command) {
  if (command !== "mark") marking = false;
  switch (command) {
    case "stop":
      stop.press();
      break;
    case "auto":
    case "manual":
    case "hold":
      void ask(command);
      break;
    case "prepare":
      void prepare();
      break;
    case "mark":
      marking = !marking;
      break;
    case "scale":
      void changeScale();
      break;
    case "place":
      visit?.placeAnew();
      break;
    case "leave":
      void visit?.end();
      break;
  }
}

/** @param {Ask} name */
async function ask(name) {
  const answer = await twin.ask(name);
  if (!answer.ok) say(answer.message);
}

/** Whatever comes before driving: a seat, the way out of a latch, arming; and the way back. */
async function prepare() {
  if (!mayAsk()) await sitDown();
  else if (state?.mode === "FAULT" || state?.mode === "STOP") await ask("reset");
  else await ask(state?.mode === "DISARMED" ? "arm" : "disarm");
}

async function changeScale() {
  const scale = state?.hand.scale === "fine" ? "coarse" : "fine";
  await request("POST", "/hand", { scale }).catch((error) => say(explain(error)));
}

/** @param {Hit} hit */
function onMark(hit) {
  if (hit.kind === "button") return;
  marking = false;
  const [x, y] = hit.kind === "image" ? hit.at : [hit.at.x_px, hit.at.y_px];
  const center = { frame: hit.kind === "image" ? "image" : "vessel", x, y };
  const body = { center, epsilon_um: NEW_EPSILON_UM, label: "" };
  request("POST", "/critical-areas", body).catch((error) => say(explain(error)));
}

/** @param {Triple | null} place_m @param {boolean} clutch @param {number} now_ms */
function onHand(place_m, clutch, now_ms) {
  seen = place_m !== null;
  cockpit?.showHand(place_m, clutch);
  if (place_m) sender.see(place_m, clutch, now_ms);
  else sender.lose();
}

/** @param {number} now_ms */
function onFrame(now_ms) {
  if (!cockpit) return;
  const fresh = now_ms - received_ms <= STALE_MS;
  const operator = snapshot?.role === "operator";
  cockpit.menu.describe({ state, fresh, mayAsk: mayAsk(), operator, marking });
  if (!draw) return;
  const message = now_ms - told_ms < MESSAGE_MS ? told : "";
  cockpit.menu.draw(now_ms);
  cockpit.hud.show({ state, fresh, simulated: snapshot?.rig.simulated ?? false, seated, seen, message });
  if (snapshot && state) cockpit.microscope.show(snapshot, state, areas, now_ms);
}

function mayAsk() {
  return seated || (snapshot !== null && state?.lease.console === snapshot.seat);
}

/** Bring the page up to date. */
function show() {
  const fresh = performance.now() - received_ms <= STALE_MS;
  stop.confirm(fresh && state?.mode === "STOP");
  root.dataset.seated = String(seated);
  root.dataset.hand = seen ? "seen" : "lost";
  if (!looked) return;
  const { checks, ready } = assess({ ...browser, link, signedOut, role: snapshot?.role ?? null });
  enter.disabled = !ready || visit !== null;
  setText(enter, browser.immersion === "immersive-vr" ? "Enter virtual reality" : "Enter mixed reality");
  const missing = checks.filter(({ verdict }) => verdict === "missing");
  setText(byId("summary", HTMLElement), summaryOf(ready, missing.length));
  const list = byId("checks", HTMLUListElement);
  const key = JSON.stringify(checks);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(
    ...checks.map(({ name, verdict, text }) =>
      make("li", { "data-verdict": verdict }, icon(`i-${verdict}`), make("strong", {}, name), make("p", {}, text)),
    ),
  );
}

/** @param {boolean} ready @param {number} missing */
function summaryOf(ready, missing) {
  if (visit) return "You are inside. Take the headset off to come back.";
  if (ready) return "The twin will stand on the table before you, with the microscope behind it.";
  if (missing === 0) return "Waiting for the server…";
  return missing === 1 ? "One thing is missing before you can enter." : `${missing} things are missing before you can enter.`;
}

/** Offer the authority that a headset has to trust, if this rig has one. */
async function offerAuthority() {
  const answer = await fetch("/ca.crt", { method: "HEAD" }).catch(() => null);
  byId("authority", HTMLElement).hidden = !answer?.ok;
}

async function examine() {
  browser = await look();
  looked = true;
  show();
}

enter.addEventListener("click", () => void begin());
navigator.xr?.addEventListener("devicechange", () => void examine());
twin.start();
void examine();
void offerAuthority();
setInterval(show, SHOW_MS);
