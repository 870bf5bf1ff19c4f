// Alarms of all rigs that somebody may see.

import { html, useEffect, useState } from "/ui.js";
import { call } from "/api.js";
import { Do, clock } from "/parts.js";
import { usePoll } from "./poll.js";

function Row({ alarm, done }) {
  const see = () => call("POST", `/api/alarms/${alarm.id}/acknowledge`).then(done);
  const span = `${clock(alarm.first_utc, true)}${alarm.ended_utc ? ` to ${clock(alarm.ended_utc, true)}` : ""}`;
  return html`<li class=${alarm.ended_utc ? "" : alarm.severity}><time>${span}</time><span>${alarm.text || alarm.name}</span>
    ${alarm.rig && html`<a href=${`#rig=${encodeURIComponent(alarm.rig)}`}>${alarm.rig}</a>`}
    ${alarm.seen_by ? html`<span class="quiet">seen by ${alarm.seen_by}</span>` : html`<${Do} label=${`Acknowledge: ${alarm.text}`} act=${see}>Acknowledge<//>`}
  </li>`;
}

export function Alarms({ tell }) {
  const [lasting, setLasting] = useState(true);
  const { found, error, again } = usePoll(`/api/alarms?lasting=${lasting ? 1 : 0}`, 10);
  useEffect(() => { if (found) tell(found); }, [found]);
  return html`<main><section class="card wide" aria-label="Alarms"><h2>Alarms</h2>
    <div class="row">${[[true, "Those that last"], [false, "All"]].map(([each, words]) => html`<button key=${words} class=${lasting === each ? "on" : ""} aria-pressed=${lasting === each} onClick=${() => setLasting(each)}>${words}</button>`)}</div>
    ${error && html`<p class="error" role="alert">${error}</p>`}
    <ul class="events">${(found?.alarms ?? []).map((alarm) => html`<${Row} key=${alarm.id} alarm=${alarm} done=${again} />`)}</ul>
    ${found && !found.alarms.length && html`<p class="quiet">There is none.</p>`}
  </section></main>`;
}
