// The squares of a statement: an answer to each, saved as JSON for --answers.
(() => {
  const chosen = (card) => card.querySelector("input:checked");

  function changed() {
    cards.forEach((card) => { card.dataset.status = chosen(card) ? "ok" : "open"; });
    changedTo(cards.filter(chosen).length, "answered");
  }

  function press(card, key) {
    if (key !== "u" && !/^[0-4]$/.test(key)) return false;
    if (key === "u") card.querySelectorAll("input").forEach((input) => { input.checked = false; });
    else card.querySelector(`input[value="${key}"]`).checked = true;
    changed();
    return true;
  }

  function save() {
    const answers = { ...data.answers };
    cards.forEach((card, i) => {
      if (chosen(card)) answers[data.draws[i]] = data.shares[chosen(card).value];
    });
    const number = cards.filter(chosen).length;
    if (!number) {
      saved.textContent = "No square is answered.";
      return;
    }
    const text = number === 1 ? "1 answer" : `${number} answers`;
    download({ sample: data.sample, answers }, "application/json", `answers-${Object.keys(answers).length}.json`, text);
  }

  cards.forEach((card) => card.addEventListener("input", changed));
  changed();
  listen(save, press);
})();
