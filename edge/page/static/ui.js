// Preact with htm. htm would keep what does not change and hand out the same node again; a part that is drawn anew
// each second then lost its place among its neighbours now and then, and failed. So nothing is kept.

const { h, render } = preact;
export const html = htm.bind(function (...given) {
  this[0] = 3; // htm's way to say: do not keep it
  return h(...given);
});
export { render };
export const { useEffect, useErrorBoundary, useMemo, useRef, useState } = preactHooks;
