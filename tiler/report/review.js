"use strict";
// The cards: a decision on each place by mouse or keyboard, saved as GeoJSON for --edits.
(() => {
  const data = JSON.parse(document.getElementById("data").textContent);
  const cards = [...document.querySelectorAll(".place")];
  const decided = document.getElementById("decided"), saved = document.getElementById("saved");
  const WORDS = { o: "ok", f: "fixed", u: "open" };
  let at = -1, isSaved = true;

  const field = (card, name) => card.querySelector(`[name="${name}"]`);
  const status = (card) => card.querySelector("input[type=radio]:checked")?.value ?? "open";

  function choose(card, value) {
    const choice = card.querySelector(`input[value="${value}"]`);
    if (!choice) return;
    choice.checked = true;
    changed(card);
  }

  function changed(card) {
    isSaved = false;
    saved.textContent = "";
    card.dataset.status = status(card);
    fault(card);
    const number = cards.filter((each) => status(each) !== "open").length;
    decided.textContent = `${number} of ${cards.length} decided`;
  }

  // A change needs an edit, and a flat one a height.
  function fault(card) {
    const told = card.querySelector("output");
    if (!told) return "";
    const action = field(card, "action").value;
    told.textContent = status(card) !== "fixed" ? ""
      : !action ? "Choose an edit."
      : action === "flat" && field(card, "z").value === "" ? "Give the height."
      : "";
    return told.textContent;
  }

  function go(number) {
    if (!cards.length) return;
    at = Math.min(Math.max(number, 0), cards.length - 1);
    cards.forEach((card, i) => card.classList.toggle("current", i === at));
    cards[at].focus({ preventScroll: true });
    cards[at].scrollIntoView({ block: "start" });
  }

  function feature(card, place) {
    const z = field(card, "z").value;
    return {
      type: "Feature",
      properties: {
        ...place.columns, status: status(card), action: field(card, "action").value,
        z: z === "" ? null : Number(z), note: field(card, "note").value,
      },
      geometry: JSON.parse(place.geometry),
    };
  }

  function save() {
    if (!data.crs) return;
    const wrong = cards.findIndex((card) => fault(card));
    if (wrong >= 0) {
      saved.textContent = "A place needs an edit.";
      go(wrong);
      return;
    }
    const features = cards
      .map((card, i) => [card, data.places[i]])
      .filter(([card, place]) => place.geometry && status(card) !== "open")
      .map(([card, place]) => feature(card, place));
    if (!features.length) {
      saved.textContent = "No place is decided.";
      return;
    }
    const collection = {
      type: "FeatureCollection", name: "review",
      crs: { type: "name", properties: { name: data.crs } }, features,
    };
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([JSON.stringify(collection)], { type: "application/geo+json" }));
    link.download = "decisions.geojson";
    link.click();
    URL.revokeObjectURL(link.href);
    isSaved = true;
    saved.textContent = `Saved ${features.length} as decisions.geojson in your downloads.`;
  }

  cards.forEach((card, i) => {
    choose(card, "open");
    card.addEventListener("input", () => changed(card));
    card.addEventListener("focusin", () => {
      at = i;
      cards.forEach((each) => each.classList.toggle("current", each === card));
    });
  });
  isSaved = true;
  document.getElementById("save")?.addEventListener("click", save);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=text], input[type=number], select")) return;
    if (event.key === "n") go(at + 1);
    else if (event.key === "p") go(at - 1);
    else if (event.key === "s") save();
    else if (WORDS[event.key] && at >= 0) choose(cards[at], WORDS[event.key]);
    else return;
    event.preventDefault();
  });
  window.addEventListener("beforeunload", (event) => { if (!isSaved) event.preventDefault(); });
  document.documentElement.dataset.ready = "yes";
})();
