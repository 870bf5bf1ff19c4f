// Calls of the page's own API, and the stream of what the rig does.

export class Refused extends Error {
  constructor(status, text) {
    super(text);
    this.status = status;
  }
}

export async function call(method, path, body) {
  const options = { method, headers: {}, credentials: "same-origin" };
  if (method !== "GET") {
    options.headers["content-type"] = "application/json";
    options.body = JSON.stringify(body ?? {});
  }
  let answer;
  try {
    answer = await fetch(path, options);
  } catch {
    throw new Refused(0, "the page's server does not answer");
  }
  const found = await answer.json().catch(() => ({ error: `status ${answer.status}` }));
  if (!answer.ok || found.ok === false) throw new Refused(answer.status, found.error ?? `status ${answer.status}`);
  return found;
}

// Hands each view of the rig to `take`, and null while there is none; returns what ends it. A stream that breaks
// is opened again by the browser; one that is refused gives way to a question every two seconds.
export function follow(take) {
  let timer = null;
  let last = 0;
  const source = new EventSource("/api/stream");
  const hear = (view) => {
    last = Date.now();
    take({ ...view, heard: last });
  };
  source.onmessage = (event) => hear(JSON.parse(event.data));
  const ask = async () => {
    if (source.readyState === EventSource.CLOSED || Date.now() - last > 12000) {
      try {
        hear(await call("GET", "/api/view"));
      } catch (error) {
        take(null, error);
      }
    }
    timer = setTimeout(ask, 2000);
  };
  timer = setTimeout(ask, 2000);
  return () => {
    source.close();
    clearTimeout(timer);
  };
}
