// Asks again and again while the page is looked at; an error stays shown until an answer comes.

import { useEffect, useState } from "/ui.js";
import { call } from "/api.js";

// path : asked at once when it changes, then every `every` seconds. Returns { found, error, again }.
export function usePoll(path, every) {
  const [state, setState] = useState({ found: null, error: "" });
  const [asked, setAsked] = useState(0);
  useEffect(() => {
    let timer = null;
    let over = false;
    const look = async () => {
      try {
        const found = document.hidden ? null : await call("GET", path);
        if (!over && found) setState({ found, error: "" });
      } catch (error) {
        if (error.status === 401) return location.reload();
        if (!over) setState((before) => ({ ...before, error: error.message }));
      }
      if (!over) timer = setTimeout(look, 1000 * every);
      return undefined;
    };
    look();
    return () => { over = true; clearTimeout(timer); };
  }, [path, every, asked]);
  return { ...state, again: () => setAsked((before) => before + 1) };
}
