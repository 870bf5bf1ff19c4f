// Alarms that leave the page: how each channel has done, a test, and the alarms that are open.

import { html, useEffect, useState } from "./ui.js";
import { call } from "./api.js";
import { Do, clock } from "./parts.js";

const NAMES = { ntfy: "ntfy", mail: "E-mail", webhook: "Webhook", life_sign: "Sign of life" };
const LOOK_MS = 15000;

function Way({ way, mayTest, load }) {
  const [ended, setEnded] = useState("");
  const test = async () => {
    setEnded("");
    try {
      await call("POST", "/api/alarms/test", { channel: way.name });
      setEnded("arrived");
    } catch (error) {
      if (error.status !== 502) throw error;
      setEnded("failed"); // the reason stands below, as of any message
    }
    await load();
  };
  const name = NAMES[way.name] ?? way.name;
  const failed = way.failed_utc && !(way.sent_utc > way.failed_utc);
  return html`<li>
    <div class="row"><strong>${name}</strong><span class="quiet">${way.to}</span>
      ${mayTest && html`<${Do} act=${test} label=${`Test ${name}`}>Test<//>`}<span role="status">${ended}</span></div>
    <p class="quiet">Last success: ${way.sent_utc ? clock(way.sent_utc, true) : "none yet"}</p>
    ${way.failed_utc && html`<p class=${failed ? "error" : "quiet"}>Last failure: ${clock(way.failed_utc, true)}, ${way.reason}</p>`}
    ${way.waiting > 0 && html`<p class="error">${way.waiting === 1 ? "1 alarm waits" : `${way.waiting} alarms wait`}${way.wait_s > 0 ? `, next try in ${Math.ceil(way.wait_s)} s` : ""}</p>`}
    ${way.withheld && html`<p class="error">Withheld: ${way.withheld}</p>`}
  </li>`;
}

export function Alarms({ me, news }) {
  const [found, setFound] = useState(null);
  const [error, setError] = useState("");
  const load = () => call("GET", "/api/alarms").then((answer) => { setFound(answer); setError(""); }, (failed) => setError(failed.message));
  const sees = me.role !== "view";
  // Also without ticks: a silent daemon is when it matters.
  useEffect(() => {
    if (!sees) return undefined;
    load();
    const timer = setInterval(load, LOOK_MS);
    return () => clearInterval(timer);
  }, [news]);
  if (!sees || (!found && !error)) return null;
  const ways = [...(found?.channels ?? []), ...(found?.life_sign ? [found.life_sign] : [])];
  return html`<section class="card" aria-label="Alarms by message"><h2>Alarms by message</h2>
    ${error && html`<p class="error">${error}</p>`}
    ${found && !ways.length && html`<p class="quiet">No alarm leaves this page. The manual's chapter “Alarms to your phone” says how to set up ntfy, e-mail or a webhook: the section <code>alarms</code> of edge.yaml.</p>`}
    <ul class="events">${(found?.alarms ?? []).map((alarm) => html`<li key=${alarm.id} class="alarm">
      <time>${clock(alarm.begun_utc, true)}</time><span>${alarm.text}${alarm.times > 1 ? ` (${alarm.times} times)` : ""}</span>
      ${alarm.seen_by ? html`<span class="quiet">seen by ${alarm.seen_by}</span>`
        : html`<${Do} act=${() => call("POST", "/api/alarms/acknowledge", { id: alarm.id }).then(load)}>Acknowledge<//>`}</li>`)}</ul>
    <ul class="ways">${ways.map((way) => html`<${Way} key=${way.name} way=${way} mayTest=${me.role === "admin"} load=${load} />`)}</ul>
  </section>`;
}
