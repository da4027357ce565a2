// Places to review: a decision on each place by mouse or keyboard, saved as GeoJSON for --edits.
(() => {
  const WORDS = { o: "ok", f: "fixed", u: "open" };

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
    card.dataset.status = status(card);
    card.querySelector("output").textContent = fault(card);
    changedTo(cards.filter((each) => status(each) !== "open").length, "decided");
  }

  function fault(card) {
    if (!field(card, "action")) return "";
    if (status(card) === "open") return note(card) === field(card, "note").defaultValue ? "" : "Decide, or the note is lost.";
    if (status(card) === "ok") return "";
    const action = field(card, "action").value;
    if (!action) return "Choose an edit.";
    return action === "flat" && !Number.isFinite(height(card)) ? "Give the height as a number." : "";
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
    const number = decisions.length === 1 ? "1 decision" : `${decisions.length} decisions`;
    download(collection, "application/geo+json", "decisions.geojson", number);
  }

  function press(card, key) {
    if (WORDS[key]) choose(card, WORDS[key]);
    return key in WORDS;
  }

  cards.forEach((card) => {
    card.addEventListener("input", (event) => {
      if (event.target.matches('[name="action"], [name="z"]') && status(card) === "open") choose(card, "fixed");
      changed(card);
    });
    choose(card, "open");
  });
  listen(save, press);
})();
