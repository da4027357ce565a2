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
  const height = (card) => Number(field(card, "z").value.trim().replace(",", ".") || NaN);
  const note = (card) => field(card, "note").value;

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
    card.querySelector("output").textContent = fault(card);
    const number = cards.filter((each) => status(each) !== "open").length;
    decided.textContent = `${number} of ${cards.length} decided`;
  }

  function fault(card) {
    if (!field(card, "action")) return "";
    if (status(card) === "open") return note(card) === field(card, "note").defaultValue ? "" : "Decide, or the note is lost.";
    if (status(card) === "ok") return "";
    const action = field(card, "action").value;
    if (!action) return "Choose an edit.";
    return action === "flat" && !Number.isFinite(height(card)) ? "Give the height as a number." : "";
  }

  function go(number) {
    if (!cards.length) return;
    at = Math.min(Math.max(number, 0), cards.length - 1);
    cards.forEach((card, i) => card.classList.toggle("current", i === at));
    cards[at].focus({ preventScroll: true });
    cards[at].scrollIntoView({ block: "start" });
  }

  function feature(columns, geometry) {
    return { type: "Feature", properties: columns, geometry: JSON.parse(geometry) };
  }

  function decision(card, place) {
    const z = height(card);
    return feature({
      ...place.columns, status: status(card), action: field(card, "action").value,
      z: Number.isFinite(z) ? z : null, note: note(card),
    }, place.geometry);
  }

  function save() {
    if (!data.crs) return;
    const wrong = cards.findIndex((card) => fault(card));
    if (wrong >= 0) {
      saved.textContent = `${cards[wrong].querySelector("h3").textContent}: ${fault(cards[wrong])}`;
      go(wrong);
      return;
    }
    const decisions = cards.map((card, i) => [card, data.places[i]])
      .filter(([card]) => status(card) !== "open").map(([card, place]) => decision(card, place));
    if (!decisions.length) {
      saved.textContent = "No place is decided.";
      return;
    }
    const features = [...data.kept.map((row) => feature(row.columns, row.geometry)), ...decisions];
    const collection = {
      type: "FeatureCollection", name: "review",
      crs: { type: "name", properties: { name: data.crs } }, features,
    };
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([JSON.stringify(collection)], { type: "application/geo+json" }));
    link.download = "decisions.geojson";
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 60000);
    isSaved = true;
    const number = decisions.length === 1 ? "1 decision" : `${decisions.length} decisions`;
    saved.textContent = `Saved ${number} as decisions.geojson in your downloads.`;
  }

  cards.forEach((card, i) => {
    card.addEventListener("input", (event) => {
      if (event.target.matches('[name="action"], [name="z"]') && status(card) === "open") choose(card, "fixed");
      changed(card);
    });
    card.addEventListener("focusin", () => {
      at = i;
      cards.forEach((each) => each.classList.toggle("current", each === card));
    });
    choose(card, "open");
  });
  isSaved = true;
  document.getElementById("save")?.addEventListener("click", save);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=text], select")) return;
    const key = event.key.toLowerCase();
    if (key === "n") go(at + 1);
    else if (key === "p") go(at - 1);
    else if (key === "s") { if (!event.repeat) save(); }
    else if (WORDS[key] && at >= 0) choose(cards[at], WORDS[key]);
    else return;
    event.preventDefault();
  });
  window.addEventListener("beforeunload", (event) => { if (!isSaved) event.preventDefault(); });
  document.documentElement.dataset.ready = "yes";
})();
