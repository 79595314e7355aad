// Wide code, tables and equations for users of keyboards and screen readers, where the theme lacks something.
const mend = (part, box) => {
  // The arrow keys scroll what has the focus. The theme gives the focus to code only, and only where a pointer can hover.
  if (box.scrollWidth > box.clientWidth && !box.hasAttribute("tabindex")) box.tabIndex = 0
  // The button to copy is in a nav of its own. As a landmark, it would be listed once for each block.
  part.querySelector("nav:not([role])")?.setAttribute("role", "none")
}
for (const code of document.querySelectorAll("pre > code")) {
  const look = () => mend(code.parentElement, code)
  new ResizeObserver(look).observe(code)
  new MutationObserver(look).observe(code.parentElement, { childList: true, subtree: true, attributeFilter: ["tabindex"] })
}
for (const table of document.querySelectorAll(".md-typeset table")) {
  new ResizeObserver(() => mend(table, table.closest(".md-typeset__scrollwrap") ?? table)).observe(table)
}
for (const equation of document.querySelectorAll(".md-typeset .equation")) {
  new ResizeObserver(() => mend(equation, equation)).observe(equation)
}
