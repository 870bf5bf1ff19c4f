// The parts of the page. What is shown of heater and fan is what the board has echoed, and how old that is.

import { html, useEffect, useState } from "./ui.js";
import { call } from "./api.js";

export const degrees = (value, digits = 1) => (value == null ? "–" : `${value.toFixed(digits)} °C`);
export const percent = (value) => (value == null ? "–" : `${Math.round(100 * value)} %`);
export const clock = (utc, withDay = false) => {
  if (utc == null) return "–";
  const options = withDay ? { weekday: "short", hour: "2-digit", minute: "2-digit", hourCycle: "h23" } : { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" };
  return new Date(1000 * utc).toLocaleString([], options);
};
export const seconds = (value) => (value == null ? "–" : value < 90 ? `${Math.round(value)} s` : value < 5400 ? `${Math.round(value / 60)} min` : `${Math.round(value / 3600)} h`);

// A button that waits for the answer of what it does, and shows what was refused.
export function Do({ act, children, label, kind = "", disabled = false }) {
  const [state, setState] = useState({ busy: false, error: "" });
  const run = async () => {
    setState({ busy: true, error: "" });
    try {
      await act();
      setState({ busy: false, error: "" });
    } catch (error) {
      setState({ busy: false, error: error.message });
    }
  };
  return html`<span class="do">
    <button class=${kind} disabled=${disabled || state.busy} aria-label=${label} onClick=${run}>${children}</button>
    ${state.error && html`<span class="error" role="alert">${state.error}</span>`}
  </span>`;
}

// Where somebody comes in. reason : why there is no session, "" for none; entered() : called after a login; children : how to come in
export function Door({ title = "Greenhouse", reason, entered, children }) {
  const [name, setName] = useState("");
  const [password, setPassword] = useState("");
  const [error, setError] = useState(reason);
  const enter = (event) => {
    event.preventDefault();
    call("POST", "/api/session", { name, password }).then(entered, (failed) => setError(failed.message));
  };
  return html`<main class="door"><section class="card"><h1>${title}</h1>
    <p>${children}</p>
    ${error && html`<p class="error" role="alert">${error}</p>`}
    <form onSubmit=${enter}>
      <label>Name <input autocomplete="username" value=${name} onInput=${(event) => setName(event.target.value)} /></label>
      <label>Password <input type="password" autocomplete="current-password" value=${password} onInput=${(event) => setPassword(event.target.value)} /></label>
      <button class="plain">Log in</button>
    </form></section></main>`;
}

// Sentences about what is wrong, the gravest first: [style, text].
export function troubles(view, lost) {
  const found = [];
  const status = view?.status;
  const operation = status?.operation;
  if (lost) found.push(["alarm", `No word from this page's server: ${lost.message}. What follows is old.`]);
  if (view && !view.reached) {
    const ago = view.silent_s == null ? "" : ` Its last word is ${seconds(view.silent_s)} old.`;
    const lease = view.silent_s != null && view.silent_s > view.lease_s
      ? ` By its lease of ${view.lease_s} s the board has turned everything off by now, which nobody has confirmed.` : "";
    found.push(["alarm", `The daemon does not answer: ${view.error}.${ago}${lease}`]);
  }
  if (view?.stop_waits) {
    found.push(["alarm", `A stop by ${view.stop_waits.by} waits for the daemon. It will not heat again until it is released.`]);
  }
  if (operation?.emergency_stop) {
    const off = status.echo && !status.echo.heater_duty && !status.echo.fan_share;
    const board = !view.reached ? "" : !status.link_up ? " The board does not answer."
      : off ? " The board confirms: heater and fan are off." : " The board has not confirmed it yet.";
    found.push(["alarm", `Emergency stop: everything stays off until it is released.${board}`]);
  }
  if (view?.reached && status) {
    if (status.foreign_board) found.push(["alarm", `Another board is at the port and not driven: ${status.foreign_board}. If it is the right one: greenhouse board accept.`]);
    else if (!status.link_up) found.push(["alarm", "The board is silent. It turns its heater off by itself; its present state is unknown."]);
    const asked = { emergency_stop: operation.emergency_stop, maintenance: operation.maintenance_until_utc };
    if (status.echo?.tripped && !asked[status.echo.trip_cause]) found.push(["alarm", `The board has tripped: ${status.echo.trip_cause}.`]);
    for (const trip of status.trips) found.push(["alarm", `Tripped: ${trip}.`]);
    if (operation.maintenance_until_utc) found.push(["warn", `Maintenance until ${clock(operation.maintenance_until_utc)}: everything is off.`]);
    const air = status.tick?.readings.temp_air_c;
    if (status.tick && (!air || air.quality !== "good")) found.push(["warn", `The air's sensor: ${air?.quality ?? "absent"}.`]);
    if (status.drift?.state === "disagrees") found.push(["warn", status.drift.text]);
  }
  return found;
}

export function Now({ view, lost }) {
  const status = view?.status;
  const tick = status?.tick;
  const old = lost || !view?.reached;
  const echo = status?.echo;
  const how = old ? `last confirmed ${seconds(view?.silent_s)} ago` : echo && status.link_up ? "confirmed by the board" : "not confirmed";
  const air = tick?.readings.temp_air_c;
  const known = echo && status.link_up;
  return html`<section class="now ${old ? "old" : ""}" aria-label="Now">
    <div class="big"><span class="label">Air</span><strong>${degrees(air?.value)}</strong>
      <span class="quiet">${air ? (air.quality === "good" ? `at ${clock(tick.utc)}` : air.quality) : "no reading"}</span></div>
    <div class="big"><span class="label">Reference</span><strong>${degrees(tick?.reference_c)}</strong>
      <span class="quiet">by ${tick?.controller ?? "–"}</span></div>
    <div><span class="label">Heater</span><strong>${known ? percent(echo.heater_duty) : "?"}</strong><span class="quiet">${how}</span></div>
    <div><span class="label">Fan</span><strong>${known ? (echo.fan_share <= 0 ? "off" : echo.fan_share >= 1 ? "on" : percent(echo.fan_share)) : "?"}</strong><span class="quiet">${how}</span></div>
    <div><span class="label">Room</span><strong>${degrees(tick?.estimate.temp_ambient_c)}</strong></div>
    <div><span class="label">Humidity</span><strong>${tick?.readings.rel_humidity_pct?.value == null ? "–" : `${Math.round(tick.readings.rel_humidity_pct.value)} %`}</strong></div>
  </section>`;
}

export function Stop({ view, me, done }) {
  const [said, setSaid] = useState(null);
  const stopped = view?.status?.operation.emergency_stop;
  const stop = async () => {
    setSaid({ text: "Stop is on its way …" });
    try {
      const answer = await call("POST", "/api/stop");
      setSaid(answer.warning ? { text: answer.warning } : null);
      done(answer);
    } catch (error) {
      setSaid({ text: `The stop did not arrive: ${error.message}. Pull the plug.`, failed: true });
      done();
    }
  };
  return html`<footer class="stop">
    ${said && html`<p role="alert" class=${said.failed ? "failed" : ""}>${said.text}</p>`}
    <div class="row">
      <button class="stop" onClick=${stop}>STOP</button>
      ${stopped && me.may.includes("release_emergency_stop") && html`<${Do} kind="plain"
        act=${() => call("POST", "/api/order", { do: "release_emergency_stop" }).then(done)}>Release the stop<//>`}
    </div>
  </footer>`;
}

const MODES = [["auto", "Automatic"], ["heat", "Heat only"], ["fan_only", "Fan only"], ["off", "Off"]];

export function Controls({ view, me, done }) {
  const operation = view?.status?.operation;
  const tick = view?.status?.tick;
  const [wish, setWish] = useState(null);
  const order = (message) => call("POST", "/api/order", message).then(done);
  if (!operation || !me.may.includes("set_mode")) return null;
  const target = wish ?? operation.reference_c ?? tick?.reference_c ?? 24;
  const step = (by) => setWish(Math.round(10 * (target + by)) / 10);
  return html`<section class="card" aria-label="Control"><h2>Control</h2>
    <div class="row">
      <span class="label">Set point</span>
      <button aria-label="half a degree less" onClick=${() => step(-0.5)}>−</button>
      <output>${degrees(target)}</output>
      <button aria-label="half a degree more" onClick=${() => step(0.5)}>+</button>
      <${Do} kind="plain" disabled=${wish == null} act=${() => order({ do: "set_reference", reference_c: wish }).then(() => setWish(null))}>Set<//>
      ${operation.reference_c != null && html`<${Do} act=${() => order({ do: "set_reference", reference_c: null }).then(() => setWish(null))}>Follow the programme again<//>`}
    </div>
    <div class="row" role="group" aria-label="Mode"><span class="label">Mode</span>
      ${MODES.map(([mode, words]) => html`<${Do} key=${mode} kind=${operation.mode === mode ? "on" : ""} act=${() => order({ do: "set_mode", mode })}>${words}<//>`)}
    </div>
    <div class="row"><label class="label" for="controller">Controller</label>
      <select id="controller" value=${operation.controller} onChange=${(event) => order({ do: "set_controller", name: event.target.value }).catch((error) => alert(error.message))}>
        ${[...new Set([operation.controller, ...me.controllers])].map((name) => html`<option key=${name} value=${name}>${name}</option>`)}
      </select>
    </div>
    <div class="row"><span class="label">Maintenance</span>
      ${operation.maintenance_until_utc
        ? html`<${Do} act=${() => order({ do: "maintenance", minutes: 0 })}>End it<//>`
        : [15, 60].map((minutes) => html`<${Do} key=${minutes} act=${() => order({ do: "maintenance", minutes })}>${minutes} min<//>`)}
      ${view.status.trips.length > 0 && html`<${Do} act=${() => order({ do: "clear_trip" })}>Clear the trip<//>`}
      ${"air.jump_contradicted" in view.status.conditions && html`<${Do} act=${() => order({ do: "clear_trip" })}>Accept the air's value<//>`}
    </div>
  </section>`;
}

export function Ask({ me, done }) {
  const [words, setWords] = useState("");
  const [proposal, setProposal] = useState(null);
  const [why, setWhy] = useState("");
  useEffect(() => {
    if (proposal?.state !== "thinking") return undefined;
    const again = setTimeout(() => call("POST", "/api/order", { do: "proposal", id: proposal.id }).then((found) => setProposal(found.proposal)), 1000);
    return () => clearTimeout(again);
  }, [proposal]);
  if (!me.may.includes("ask")) return null;
  const ask = async () => setProposal((await call("POST", "/api/order", { do: "ask", words })).proposal);
  const confirm = async () => {
    const answer = await call("POST", "/api/order", { do: "confirm", id: proposal.id });
    setProposal(null);
    setWords("");
    done(answer);
  };
  const discard = async () => {
    if (proposal.state === "ready") await call("POST", "/api/order", { do: "discard", id: proposal.id, why });
    setProposal(null);
    setWhy("");
    done();
  };
  return html`<section class="card" aria-label="Ask"><h2>Ask in words</h2>
    <div class="row"><input aria-label="What you want" placeholder="two degrees warmer until tomorrow noon" value=${words} onInput=${(event) => setWords(event.target.value)} />
      <${Do} disabled=${!words.trim()} act=${ask}>Ask<//>
      <${Do} act=${() => call("POST", "/api/order", { do: "undo" }).then(done)}>Undo the last one<//></div>
    ${proposal && html`<div class="proposal" role="status">
      ${proposal.state === "thinking" ? html`<p>The language model thinks …</p>` : html`
        <p>${proposal.said || proposal.error || proposal.state}</p>
        <ul>${proposal.changes.map((change) => html`<li key=${change}>${change}</li>`)}</ul><p class="quiet">${proposal.effect}</p>`}
      <div class="row">${proposal.state === "ready" && html`<${Do} kind="plain" act=${confirm}>Confirm<//>`}
        <${Do} act=${discard}>Discard<//>
        ${proposal.state === "ready" && html`<input aria-label="Why not" placeholder="why not, for the memory" maxlength="200" value=${why} onInput=${(event) => setWhy(event.target.value)} />`}</div></div>`}
  </section>`;
}

// The sentence that says most of the reasons of a tick: what was wanted, or who decided instead.
const reason = (lines) => lines.find((line) => / wanted heater| decided, since |No controller decided|stood by hand/.test(line)) ?? lines[0];

export function Why({ view, picked, clear }) {
  const [found, setFound] = useState(null);
  useEffect(() => {
    if (picked == null) return setFound(null);
    call("GET", `/api/why?at_utc=${picked}`).then(setFound, (error) => setFound({ lines: [error.message] }));
  }, [picked]);
  const lines = picked == null ? view?.why?.lines : found?.lines;
  return html`<section class="card" aria-label="Why"><h2>Why ${picked == null ? "now" : `at ${clock(picked, true)}`}</h2>
    <p class="reason">${lines ? reason(lines) : "nothing is recorded yet"}</p>
    ${lines && html`<details><summary>Everything that led to it</summary>${lines.map((line) => html`<p key=${line}>${line}</p>`)}</details>`}
    ${picked == null ? html`<p class="quiet">Tap the chart to ask about another moment.</p>` : html`<button onClick=${clear}>Back to now</button>`}
  </section>`;
}

export function Events({ me, news }) {
  const [rows, setRows] = useState([]);
  const [least, setLeast] = useState("info");
  const [error, setError] = useState("");
  const load = () => call("GET", `/api/events?least=${least}&most=30`).then((found) => { setRows(found.events); setError(""); }, (failed) => setError(failed.message));
  useEffect(() => { load(); }, [news, least]);
  const see = (event) => call("POST", "/api/events/acknowledge", { seq: event.seq, number: event.number }).then(load);
  return html`<section class="card" aria-label="Events"><h2>Events</h2>
    <div class="row">${["info", "warning", "alarm"].map((each) => html`<button key=${each} class=${least === each ? "on" : ""} aria-pressed=${least === each} onClick=${() => setLeast(each)}>${each === "info" ? "all" : `${each}s`}</button>`)}</div>
    ${error && html`<p class="error">${error}</p>`}
    <ul class="events">${rows.map((event) => html`<li key=${`${event.seq}-${event.number}`} class=${event.severity}>
      <time>${clock(event.utc, true)}</time><span>${event.text}</span>
      ${event.severity === "alarm" && (event.acknowledged_by ? html`<span class="quiet">seen by ${event.acknowledged_by}</span>`
        : me.role !== "view" && html`<${Do} act=${() => see(event)}>Acknowledge<//>`)}
    </li>`)}</ul>
  </section>`;
}

export function Models({ view }) {
  const status = view?.status;
  const skill = Object.entries(status?.skill ?? {});
  if (!skill.length) return null;
  return html`<section class="card" aria-label="Models"><h2>Models, 15 minutes ahead</h2>
    <table><thead><tr><th>model</th><th>expects</th><th>off lately by</th><th>within its band</th></tr></thead><tbody>
    ${skill.map(([name, one]) => {
      const forecast = status.tick?.forecasts[name];
      const row = one.horizons["15"];
      return html`<tr key=${name}><th>${name}</th><td>${degrees(forecast?.temp_c["15"])}</td>
        <td>${row?.mae_k == null ? "–" : `${row.mae_k.toFixed(2)} K`}</td><td>${percent(row?.covered)}</td></tr>`;
    })}</tbody></table>
    <p class="quiet">${status.drift?.text ?? ""}</p>
  </section>`;
}

const room = (free) => (free == null ? "–" : `${free < 10000 ? `${free} MB` : `${Math.round(free / 1000)} GB`} free`);

export function Health({ view, me }) {
  const [span, setSpan] = useState({});
  const status = view?.status;
  const hour = Math.floor((status?.tick?.utc ?? 0) / 3600);
  useEffect(() => { call("GET", "/api/span").then(setSpan, (failed) => setSpan({ error: failed.message })); }, [hour]);
  if (!status) return null;
  const broken = status.conditions["telemetry.offline"] ?? status.conditions["telemetry.flooded"];
  const others = Object.entries(status.conditions).filter(([key]) => !key.startsWith("telemetry."));
  const bad = Object.entries(status.tick?.readings ?? {}).filter(([, one]) => one.quality !== "good");
  const line = status.line ?? {};
  const lost = (line.bad_crc ?? 0) + (line.given_up ?? 0) + (line.bad_cobs ?? 0);
  return html`<section class="card" aria-label="Health"><h2>Health</h2><dl>
    <dt>Daemon</dt><dd>${view.reached ? "answers" : "silent"}</dd>
    <dt>Board</dt><dd>${status.link_up ? "answers" : status.foreign_board ? "another one" : "silent"}, ${lost} of ${line.frames ?? 0} frames lost</dd>
    <dt>Sensors</dt><dd>${bad.length ? bad.map(([key, one]) => `${key}: ${one.quality}`).join(", ") : "all good"}</dd>
    <dt>Broker</dt><dd>${broken ?? (me.broker ? `${me.broker} answers` : "none is configured")}</dd>
    <dt>History</dt><dd>${span.error ?? `since ${clock(span.first_utc, true)}; ${room(span.free_mb)}`}</dd>
    <dt>Twin</dt><dd>${status.drift?.text ?? "is not watched"}</dd>
    ${others.length > 0 && html`<dt>Now wrong</dt><dd>${others.map(([, what]) => what).join("; ")}</dd>`}
    <dt>Tick</dt><dd>${status.tick ? `${status.tick.seq}, ${status.tick.late_s.toFixed(2)} s late, decided in ${Math.round(status.tick.decide_ms)} ms` : "none yet"}</dd>
  </dl></section>`;
}

export function Access({ me }) {
  const [rights, setRights] = useState({ sessions: [], links: [], people: [] });
  const [link, setLink] = useState("");
  const load = () => call("GET", "/api/sessions").then(setRights, () => {});
  useEffect(() => { if (me.role !== "view") load(); }, []);
  const end = (kind, key) => () => call("DELETE", `/api/${kind}/${encodeURIComponent(key)}`).then(load);
  const make = (role, days) => async () => {
    const found = await call("POST", "/api/links", { role, days, name: role === "view" ? "guest" : role });
    setLink(`${location.origin}/#link=${found.link}`);
  };
  const leave = () => call("DELETE", "/api/session").then(() => location.reload());
  return html`<section class="card" aria-label="Access"><h2>Access</h2>
    <p>Signed in as ${me.name} (${me.role}).</p>
    ${me.role === "admin" && html`<div class="row"><${Do} act=${make("view", 7)}>Link to view for a week<//><${Do} act=${make("operate", 0.05)}>Link for one who operates<//></div>
      ${link && html`<p><input readonly aria-label="link" value=${link} onFocus=${(event) => event.target.select()} /></p>`}
    `}
    ${me.role !== "view" && html`<ul>
      ${rights.sessions.map((row) => html`<li key=${`s${row.session}`}>${row.name} (${row.role})${row.link ? `, link ${row.link}` : ""}, seen ${clock(row.seen_utc, true)}, ${row.browser.slice(0, 40)}
        ${row.session !== me.session && html`<${Do} act=${end("sessions", row.session)}>End<//>`}</li>`)}
      ${rights.links.map((row) => html`<li key=${`l${row.link}`}>Link ${row.link}: ${row.name} (${row.role}), until ${clock(row.expires_utc, true)}
        <${Do} act=${end("links", row.link)}>End the link<//></li>`)}
      ${rights.people.map((row) => html`<li key=${`p${row.name}`}>${row.name} (${row.role}) logs in by password
        <${Do} act=${end("people", row.name)}>End the password<//></li>`)}</ul>`}
    <${Do} act=${leave}>Log out<//>
  </section>`;
}
