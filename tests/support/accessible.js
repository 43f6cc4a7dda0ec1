// What is wrong with a page for those who do not see it well, or at all: contrast below that of WCAG 2.2 AA, controls,
// pictures and regions without a name, numbers used twice, headings that leave out a level.
(() => {
  const faults = [];
  const seen = (e) => e.checkVisibility({ opacityProperty: true, visibilityProperty: true });
  const rgb = (text) => (text.match(/[\d.]+/g) || []).map(Number);
  const light = (c) => {
    const [r, g, b] = c.map((v) => v / 255).map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (e) => {
    for (let at = e; at; at = at.parentElement) {
      const colour = rgb(getComputedStyle(at).backgroundColor);
      if (colour.length === 3 || colour[3] === 1) return colour.slice(0, 3);
    }
    return [255, 255, 255];
  };
  const own = (e) => [...e.childNodes].some((n) => n.nodeType === Node.TEXT_NODE && n.textContent.trim());
  for (const e of document.querySelectorAll("body, body *")) {
    if (!seen(e) || !own(e) || e.matches(":disabled, :disabled *, script, style")) continue;
    const style = getComputedStyle(e);
    const ink = e.namespaceURI.endsWith("svg") ? rgb(style.fill) : rgb(style.color);
    const [a, b] = [light(ink.slice(0, 3)), light(behind(e))].sort((x, y) => y - x);
    const size = parseFloat(style.fontSize);
    const large = size >= 24 || (size >= 18.66 && parseInt(style.fontWeight, 10) >= 700);
    const ratio = (a + 0.05) / (b + 0.05);
    if (ratio < (large ? 3 : 4.5)) faults.push(`contrast ${ratio.toFixed(2)} of "${e.textContent.trim().slice(0, 40)}"`);
  }
  const named = (e) => e.getAttribute("aria-label") || e.labels?.length || (e.matches("button, a") && e.innerText.trim());
  for (const e of document.querySelectorAll("button, input, select, textarea, a[href]")) {
    if (seen(e) && !named(e)) faults.push(`no name: ${e.outerHTML.slice(0, 80)}`);
  }
  for (const e of document.querySelectorAll("[role=img], [role=meter], [role=group], [role=list], section")) {
    if (seen(e) && !e.getAttribute("aria-label")) faults.push(`no name: ${e.outerHTML.slice(0, 80)}`);
  }
  for (const e of document.querySelectorAll("img")) if (seen(e) && !e.alt) faults.push(`no text: ${e.src}`);
  for (const e of document.querySelectorAll("[role=list] > *")) if (e.role !== "listitem") faults.push("a list of others");
  for (const e of document.querySelectorAll("[tabindex]")) if (e.tabIndex > 0) faults.push(`order of keys: ${e.id}`);
  const numbers = [...document.querySelectorAll("[id]")].map((e) => e.id);
  if (new Set(numbers).size < numbers.length) faults.push("a number used twice");
  const levels = [...document.querySelectorAll("h1, h2, h3")].filter(seen).map((e) => Number(e.tagName[1]));
  levels.forEach((level, i) => { if (level > (levels[i - 1] || 0) + 1) faults.push(`heading ${level} after ${levels[i - 1]}`); });
  if (!document.documentElement.lang || !document.title) faults.push("no language or title");
  if (!document.querySelector("main")) faults.push("no main part");
  return faults;
})()
