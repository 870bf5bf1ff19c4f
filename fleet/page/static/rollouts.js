// Rollouts of bundles, the newest first. A wave of which too little is known waits here for a person.

import { html, useEffect, useState } from "/ui.js";
import { call } from "/api.js";
import { Do } from "/parts.js";
import { usePoll } from "./poll.js";

// With the date: a rollout may be weeks old, and the weekday of `clock` would not tell which week.
const day = (utc) => new Date(1000 * utc).toLocaleString([], { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit", hourCycle: "h23" });
const span = (row) => (row.ended_utc ? `${day(row.began_utc)} to ${day(row.ended_utc)}` : `since ${day(row.began_utc)}`);
const share = (value) => `${value > 0 ? "+" : ""}${(100 * value).toFixed(1)}\u00a0%`;
const evidence = (value) => (value < 1e6 ? Number(value.toPrecision(3)) : "over a million");
const states = (rigs) => Object.entries(rigs).map(([state, count]) => `${count} ${state}`).join(", ");

// safeFrom : evidence of no harm that is enough
function Figures({ kinds, safeFrom }) {
  const rows = Object.entries(kinds);
  if (!rows.length) return null;
  return html`<table><thead><tr><th>kind</th><th>cost</th><th>hours</th><th>evidence of harm</th><th>of no harm</th></tr></thead><tbody>
    ${rows.map(([kind, row]) => html`<tr key=${kind}><th scope="row">${kind || "–"}</th>
      ${row.difference == null ? html`<td colspan="4" class="quiet">nothing could be compared</td>`
        : html`<td>${share(row.difference)}</td><td>${row.blocks}</td><td>${evidence(row.harm)}</td><td>${evidence(row.safety)}</td>`}</tr>`)}</tbody></table>
    <p class="quiet">Evidence of no harm from ${evidence(safeFrom)} on is enough.</p>`;
}

function Wave({ wave, rollout }) {
  return html`<section class="wave" aria-label=${`Wave ${wave.wave}`}><h3>Wave ${wave.wave}: <span class=${`why ${wave.state}`}>${wave.state}</span></h3>
    ${wave.why && wave.why !== rollout.why && html`<p>${wave.why}</p>`}
    <p class="quiet">${span(wave)} · ${states(wave.rigs) || "no rig"}</p>
    <${Figures} kinds=${wave.kinds} safeFrom=${rollout.safe_from} />
  </section>`;
}

function Complaints({ rollout }) {
  if (!rollout.complaints.length) return null;
  return html`<h3>Rigs that complain</h3><ul class="items">
    ${rollout.complaints.map((row) => html`<li key=${row.rig}><a href=${`#rig=${encodeURIComponent(row.rig)}`}>${row.rig}</a> <span class="quiet">wave ${row.wave}, ${row.state}</span><br />${row.why}</li>`)}</ul>
    ${rollout.complaints_left_off > 0 && html`<p class="quiet">And ${rollout.complaints_left_off} more: <code>greenhouse fleet rollout status --rigs</code>.</p>`}`;
}

// What somebody with the right to it does about a rollout that runs; a stop is asked for twice.
// decided(error) : called with "" or with why it was refused
function Decide({ rollout, isHeld, decided }) {
  const [why, setWhy] = useState("");
  const [asks, setAsks] = useState(false);
  const decide = (what) => () => call("POST", `/api/rollouts/${rollout.number}/${what}`, why.trim() ? { why: why.trim() } : {}).then(() => { setWhy(""); decided(""); }, (error) => decided(error.message)).finally(() => setAsks(false));
  return html`<div class="row" role="group" aria-label=${`Decide about rollout ${rollout.number}`}>
    <input aria-label="Why" placeholder="why, for the record" maxlength="200" value=${why} onInput=${(event) => setWhy(event.target.value)} />
    ${isHeld && !asks && html`<${Do} kind="plain" act=${decide("go-on")}>Let it go on<//>`}
    ${!asks ? html`<button onClick=${() => setAsks(true)}>Stop and roll back</button>` : html`<div class="proposal" role="status">
      <p>Every rig that has this bundle is ordered to go back to the one before it. The rollout cannot be taken up again.</p>
      <div class="row"><${Do} kind="grave" act=${decide("stop")}>Stop it now<//><button onClick=${() => setAsks(false)}>Leave it</button></div></div>`}
  </div>`;
}

function Rollout({ rollout, done }) {
  const runs = rollout.state === "running";
  const wave = rollout.waves.find((each) => each.wave === rollout.wave);
  const isHeld = runs && wave?.state === "held";
  const may = rollout.role === "admin";
  // Kept here: where somebody else was first, the buttons go with the next answer, and the reason has to stay.
  const [refusal, setRefusal] = useState("");
  const decided = (error) => { setRefusal(error); done(); };
  return html`<section class="card wide" aria-label=${`Rollout ${rollout.number}`}>
    <h2>Bundle ${rollout.version} for ${rollout.group ? `group ${rollout.group}` : "the whole fleet"}: <span class=${`why ${rollout.state}`}>${rollout.state}</span></h2>
    <p class="quiet">rollout ${rollout.number} · ${span(rollout)}</p>
    ${rollout.why && html`<p>${rollout.why}</p>`}
    ${isHeld && html`<p class="trouble warn">Wave ${wave.wave} is held: too little is known to go on. It is judged on meanwhile, and ${may ? "you decide" : "somebody with the role admin decides"}.</p>`}
    ${runs && may && html`<${Decide} rollout=${rollout} isHeld=${isHeld} decided=${decided} />`}
    ${refusal && html`<p class="error" role="alert">${refusal}</p>`}
    ${!rollout.waves.length && html`<p class="quiet">No wave has begun yet.</p>`}
    ${[...rollout.waves].reverse().map((each) => html`<${Wave} key=${each.wave} wave=${each} rollout=${rollout} />`)}
    <${Complaints} rollout=${rollout} />
  </section>`;
}

export function Rollouts({ tell }) {
  const { found, error, again } = usePoll("/api/rollouts", 10);
  useEffect(() => { if (found) tell(found); }, [found]);
  if (!found) return html`<p class=${error ? "error" : "quiet"} role=${error ? "alert" : null}>${error || "Loading …"}</p>`;
  return html`<main>
    ${error && html`<p class="error wide" role="alert">${error}. What follows is of ${day(found.utc)}.</p>`}
    ${found.rollouts.map((rollout) => html`<${Rollout} key=${rollout.number} rollout=${rollout} done=${again} />`)}
    ${!found.rollouts.length && html`<section class="card wide" aria-label="Bundles"><p class="quiet">No bundle has been spread yet. <code>greenhouse fleet rollout start</code> begins it.</p></section>`}
    ${found.left_off > 0 && html`<p class="quiet wide">And ${found.left_off} older ones: <code>greenhouse fleet rollout status</code>.</p>`}
  </main>`;
}
