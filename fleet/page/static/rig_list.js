// All rigs that somebody may see, the worst first.

import { html, useEffect, useState } from "/ui.js";
import { clock, degrees, percent } from "/parts.js";
import { usePoll } from "./poll.js";

export const WORDS = {
  offline: "offline", tripped: "tripped", faulted: "faulted", stopped: "stopped", off_reference: "off reference", drift: "drifting", well: "well",
};

function Row({ rig }) {
  return html`<li><a class=${rig.standing} href=${`#rig=${encodeURIComponent(rig.name)}`}>
    <b>${rig.name}</b><span class="numbers">${rig.temp_air_c == null ? "–" : rig.temp_air_c.toFixed(1)}<span class="quiet"> of ${degrees(rig.reference_c)}</span></span>
    <span class=${`why ${rig.standing}`}>${rig.why || WORDS[rig.standing]}</span>
    <span class="numbers quiet">${[rig.group, rig.kind, `heater ${percent(rig.heater_duty)}`].filter(Boolean).join(" · ")}</span>
  </a></li>`;
}

function Choice({ words, value, all, set }) {
  return html`<label>${words}<select value=${value} onChange=${(event) => set(event.target.value)}>
    <option value="">all</option>${all.map((each) => html`<option key=${each} value=${each}>${each}</option>`)}</select></label>`;
}

export function RigList({ tell }) {
  const [search, setSearch] = useState("");
  const [group, setGroup] = useState("");
  const [kind, setKind] = useState("");
  const [standing, setStanding] = useState("");
  const { found, error } = usePoll(`/api/rigs?${new URLSearchParams({ search, group, kind, standing })}`, 5);
  useEffect(() => { if (found) tell(found); }, [found]);
  if (!found) return html`<p class=${error ? "error" : "quiet"}>${error || "Loading …"}</p>`;
  return html`<main><section class="card wide" aria-label="Rigs">
    ${error && html`<p class="error" role="alert">${error}. What follows is of ${clock(found.utc)}.</p>`}
    <div class="fields">
      <label>Search<input type="search" value=${search} onInput=${(event) => setSearch(event.target.value)} /></label>
      <${Choice} words="Group" value=${group} all=${found.groups} set=${setGroup} />
      <${Choice} words="Kind" value=${kind} all=${found.kinds} set=${setKind} />
    </div>
    <div class="row" role="group" aria-label="Standing">
      ${Object.entries(WORDS).filter(([word]) => found.counts[word] || word === standing).map(([word, words]) => html`<button key=${word} class=${word === standing ? "on" : ""} aria-pressed=${word === standing} onClick=${() => setStanding(word === standing ? "" : word)}>${found.counts[word]} ${words}</button>`)}
    </div>
    <ul class="rigs">${found.rigs.map((rig) => html`<${Row} key=${rig.name} rig=${rig} />`)}</ul>
    ${!found.rigs.length && html`<p class="quiet">No rig is like this.</p>`}
    ${found.left_off > 0 && html`<p class="quiet">And ${found.left_off} more: search, or choose a group.</p>`}
  </section></main>`;
}
