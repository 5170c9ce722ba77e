// What axe-core leaves open about contrast is decided here: text against what is painted behind it, which for a
// drawing's letters is their halo.  Letters that are transparent on purpose are for screen readers only.
// Called with axe-core's undecided nodes; returns those that stay open.
const rgba = (text) => { const found = text.match(/[\d.]+/g)?.map(Number) ?? []; return found.length < 3 ? null : found; };
const bright = ([r, g, b]) => [r, g, b].map((v) => v / 255).map((v) => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
  .reduce((sum, v, k) => sum + v * [0.2126, 0.7152, 0.0722][k], 0);
const ratio = (a, b) => { const [x, y] = [bright(a), bright(b)].sort((p, q) => q - p); return (x + 0.05) / (y + 0.05); };
const behind = (one) => {
  for (let at = one; at; at = at.parentElement) {
    const style = getComputedStyle(at), found = rgba(style.backgroundColor);
    const ends = (style.backgroundImage.match(/rgba?\([^)]*\)/g) ?? []).map(rgba).filter((c) => (c[3] ?? 1) === 1);
    if (found && (found[3] ?? 1) > 0) return [found, ...ends];
    if (ends.length) return [...ends, rgba(getComputedStyle(document.body).backgroundColor)];
  }
  return [[255, 255, 255]];
};
const legible = (one) => {
  const style = getComputedStyle(one), drawn = one instanceof SVGElement, text = rgba(drawn ? style.fill : style.color);
  if (!text || (text[3] ?? 1) === 0) return !drawn;
  const halo = drawn && style.paintOrder.startsWith("stroke") && parseFloat(style.strokeWidth) >= 2 && rgba(style.stroke);
  const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
  return (halo ? [halo] : behind(one)).every((back) => ratio(text, back) >= (large ? 3 : 4.5));
};
return arguments[0].filter(([rule, , target]) =>
  rule !== "color-contrast" || !legible(document.querySelector(target)));
