// The page: who looks, what the rig does, and the parts below each other.

import { html, render, useEffect, useErrorBoundary, useMemo, useRef, useState } from "./ui.js";
import { call, follow } from "./api.js";
import { Alarms } from "./alarms.js";
import { Calibration } from "./calibration.js";
import { Chart, LEGEND, columnsOf, spanAhead } from "./chart.js";
import { ModelCards } from "./models.js";
import { Memory } from "./memory.js";
import { Profile } from "./profile.js";
import { Access, Ask, Controls, Door, Events, Health, Models, Now, Stop, Why, troubles } from "./parts.js";
import { WhatIf } from "./what_if.js";

const SPANS = [[3600, "1 h"], [6 * 3600, "6 h"], [86400, "1 day"], [7 * 86400, "7 days"]];
const EMPTY = Object.fromEntries(
  ["utc", "air_c", "air_low_c", "air_high_c", "estimate_c", "reference_c", "room_c", "heater", "fan"].map((key) => [key, []]),
);

// The part of the history that is shown: it follows the rig's newest tick until somebody drags it.
function useCourse(newest) {
  const [span, setSpan] = useState(SPANS[1][0]);
  const [back, setBack] = useState(0); // [s] before now; 0: it follows
  const [course, setCourse] = useState(EMPTY);
  const [error, setError] = useState("");
  const ahead = back ? 0 : Math.min(spanAhead, span / 3);
  const last = (newest ?? Date.now() / 1000) - back + ahead;
  // A rig that has just begun shows what there is, not an empty day.
  const first = back ? last - span : Math.max(last - span, Math.min(course.utc[0] ?? 0, newest - span / 4));
  const fetched = Math.round(back / (span / 40));
  useEffect(() => {
    if (newest == null) return undefined;
    const soon = setTimeout(() => {
      const asked = `from_utc=${last - 1.5 * span}&to_utc=${last + (back ? span / 2 : 1)}&points=1000`;
      call("GET", `/api/course?${asked}`).then((found) => { setCourse(found.columns); setError(""); }, (failed) => setError(failed.message));
    }, 120);
    return () => clearTimeout(soon);
  }, [newest, span, fetched]);
  const pan = (moved) => setBack((before) => Math.max(0, before - moved));
  return { course, error, first, last, span, back, pan, setSpan, toNow: () => setBack(0) };
}

function Course({ view, pick }) {
  const status = view?.status;
  const shown = useCourse(status?.tick?.utc);
  const columns = useMemo(() => columnsOf(shown.course, status), [shown.course, status]);
  return html`<section class="card wide" aria-label="Course">
    <div class="row">
      ${SPANS.map(([span, words]) => html`<button key=${span} class=${shown.span === span ? "on" : ""} aria-pressed=${shown.span === span} onClick=${() => shown.setSpan(span)}>${words}</button>`)}
      <button aria-label="earlier" onClick=${() => shown.pan(-shown.span / 2)}>←</button>
      <button aria-label="later" disabled=${!shown.back} onClick=${() => shown.pan(shown.span / 2)}>→</button>
      ${shown.back > 0 && html`<button onClick=${shown.toNow}>Now</button>`}
    </div>
    ${shown.error && html`<p class="error">${shown.error}</p>`}
    <${Chart} columns=${columns} first=${shown.first} last=${shown.last} pick=${pick} pan=${shown.pan} />
    <ul class="legend">${LEGEND.map(([words, colour, kind]) => html`<li key=${words}><i class=${`${kind} c${colour}`}></i>${words}</li>`)}</ul>
  </section>`;
}

// A part that fails says so, and takes no other one with it.
function Part({ children }) {
  const [error] = useErrorBoundary();
  return error ? html`<section class="card"><p class="error">This part of the page failed: ${error.message}</p></section>` : children;
}

const GROUPS = { control: "Control", twin: "Models", rig: "The rig" };

// The group of cards that the address names. One that was opened stays, so that nothing half typed is lost.
function useGroup() {
  const named = () => (location.hash.slice(1) in GROUPS ? location.hash.slice(1) : "control");
  const [shown, setShown] = useState(named);
  const opened = useRef(new Set());
  opened.current.add(shown);
  useEffect(() => {
    const look = () => setShown(named());
    addEventListener("hashchange", look);
    return () => removeEventListener("hashchange", look);
  }, []);
  return { shown, opened: opened.current };
}

function Group({ name, group, children }) {
  return group.opened.has(name) && html`<div class="group" hidden=${name !== group.shown}>${children.map((child) => html`<${Part}>${child}<//>`)}</div>`;
}

// Views come by two ways and may overtake each other. After a restart of the rig's computer their clock begins anew.
const OVERTAKEN_S = 30;
const SAID_MS = 15000; // an answer describes its moment; afterwards only the view is current
const newer = (found) => (held) => {
  const ahead = held == null ? 0 : held.at_s - found.at_s;
  return ahead > 0 && ahead < OVERTAKEN_S ? held : found;
};

function Rig({ me }) {
  const [view, setView] = useState(null);
  const [lost, setLost] = useState(null);
  const [picked, setPicked] = useState(null);
  useEffect(() => follow((found, error) => {
    if (found) setView(newer(found));
    setLost(error ?? null);
    if (error?.status === 401) location.reload();
  }), []);
  const [orders, setOrders] = useState(0); // that this page has given
  const [said, setSaid] = useState(""); // the answer to this page's last order
  useEffect(() => {
    const over = setTimeout(() => setSaid(""), SAID_MS);
    return () => clearTimeout(over);
  }, [orders]);
  const done = (answer) => {
    setSaid(answer?.message ?? "");
    setOrders((before) => before + 1);
    return call("GET", "/api/view").then((found) => setView(newer(found)), () => {});
  };
  const bad = troubles(view, lost);
  const seq = view?.status?.tick?.seq;
  const group = useGroup();
  const pick = (utc) => { setPicked(utc); location.hash = "control"; };
  return html`
    <header><h1>${me.rig}</h1><span class="quiet">${view?.status?.operation.mode ?? ""}</span></header>
    <div aria-live="assertive">${bad.map(([kind, text]) => html`<p key=${text} class=${`trouble ${kind}`}>${text}</p>`)}</div>
    <p class="said" role="status">${said}</p>
    <main>
      <${Part}><${Now} view=${view} lost=${lost} /><//>
      <${Part}><${Course} view=${view} pick=${pick} /><//>
      <nav class="wide" aria-label="Parts of the page">${Object.entries(GROUPS).map(([name, words]) => html`<a key=${name} href=${`#${name}`} aria-current=${name === group.shown ? "page" : null}>${words}</a>`)}</nav>
      <${Group} name="control" group=${group}>
        <${Why} view=${view} picked=${picked} clear=${() => setPicked(null)} />
        <${Controls} view=${view} me=${me} done=${done} />
        <${Profile} view=${view} me=${me} done=${done} />
        <${Ask} me=${me} done=${done} />
        <${Memory} me=${me} news=${orders} />
        <${Events} me=${me} news=${seq} />
      <//>
      <${Group} name="twin" group=${group}>
        <${WhatIf} view=${view} />
        <${Models} view=${view} />
        <${ModelCards} me=${me} newest=${view?.status?.tick?.utc} />
      <//>
      <${Group} name="rig" group=${group}>
        <${Health} view=${view} me=${me} />
        <${Calibration} view=${view} me=${me} done=${done} />
        <${Alarms} me=${me} news=${seq} />
        <${Access} me=${me} />
      <//>
    </main>
    <${Stop} view=${view} me=${me} done=${done} />`;
}

function App() {
  const [me, setMe] = useState(null);
  const [reason, setReason] = useState(null);
  const look = () => call("GET", "/api/me").then(setMe, (error) => setReason(error.status === 401 ? "" : error.message));
  useEffect(() => {
    const link = new URLSearchParams(location.hash.slice(1)).get("link");
    if (!link) return void look();
    // At once out of the address, so that a bookmark or a screenshot does not carry it.
    history.replaceState(null, "", location.pathname);
    call("POST", "/api/session", { link }).then(look, (error) => look().then(() => setReason(error.message)));
  }, []);
  if (me) return html`<${Rig} me=${me} />`;
  return reason == null ? html`<p class="quiet">Loading …</p>` : html`<${Door} reason=${reason} entered=${look}>Open the link that <code>greenhouse page pair</code> prints on the rig's computer, or log in.<//>`;
}

render(html`<${App} />`, document.getElementById("app"));
