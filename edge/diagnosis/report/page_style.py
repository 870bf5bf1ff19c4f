"""The look of a report: light and dark, wide and narrow, on paper too."""

STYLE = """
:root { color-scheme: light dark; --page: #fbfbf9; --card: #fff; --ink: #1c2024; --soft: #5b6570;
  --line: #dfe3e6; --before: #c2500a; --after: #0f72b8; --good: #17713f; --open: #8a5a00; --code: #f0f2f3 }
@media (prefers-color-scheme: dark) { :root { --page: #14171a; --card: #1c2125; --ink: #e6e9eb;
  --soft: #a0abb5; --line: #353d44; --before: #f08c46; --after: #58b0ea; --good: #5cc88d; --open: #e0b050;
  --code: #272d33 } }
* { box-sizing: border-box }
body { margin: 0 auto; padding: 1.2rem 1rem 3rem; max-width: 50rem; background: var(--page);
  color: var(--ink); font: 16px/1.5 system-ui, sans-serif; overflow-wrap: break-word }
h1 { font-size: clamp(1.45rem, 5vw, 2rem); line-height: 1.2; margin: .3rem 0 .8rem }
h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; padding-top: .8rem; border-top: 1px solid var(--line) }
h3 { font-size: 1.02rem; margin: 1.4rem 0 .4rem }
p { margin: .5rem 0 }
.verdict { font-weight: 600; font-size: .85rem; letter-spacing: .04em; text-transform: uppercase }
.named { color: var(--after) } .nothing_missing { color: var(--good) } .unknown { color: var(--open) }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr)); gap: .6rem;
  margin: 1.2rem 0 }
.tile, figure { background: var(--card); border: 1px solid var(--line); border-radius: .5rem }
.tile { padding: .6rem .8rem }
.tile b { display: block; font-size: 1.55rem; line-height: 1.25; white-space: nowrap }
.tile span, figcaption, .soft { color: var(--soft); font-size: .875rem }
.before { color: var(--before) } .after { color: var(--after) }
figure { margin: 1rem 0; padding: .6rem }
figure svg { display: block; width: 100%; max-width: 40rem; height: auto; margin: auto; color: var(--ink) }
figcaption { margin-top: .4rem }
.table { overflow-x: auto; margin: .6rem 0 }
table { border-collapse: collapse; font-size: .9rem; min-width: 100% }
th, td { border-bottom: 1px solid var(--line); padding: .32rem .6rem; text-align: right; vertical-align: top }
th { color: var(--soft); font-weight: 600 } td.figure { white-space: nowrap }
td.words, th.words { text-align: left; min-width: 7rem } tr.kept td { font-weight: 600 }
.bar { display: inline-block; height: .65em; border-radius: 2px; background: var(--before);
  margin-right: .4em }
code, pre { background: var(--code); border-radius: .25rem; font-size: .875em; padding: .1em .3em }
pre { padding: .6rem .8rem; overflow-x: auto } ul { padding-left: 1.2rem }
dt { font-weight: 600; margin-top: .4rem } dd { margin: 0 0 0 1rem; color: var(--soft) }
summary { cursor: pointer; color: var(--soft); margin: .5rem 0 }
.hash { overflow-wrap: anywhere }
@media print { body { max-width: none } figure, .tile { break-inside: avoid } }
"""
