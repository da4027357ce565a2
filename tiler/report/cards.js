"use strict";
// Cards of a page: moving between them by mouse or keyboard, and saving of what the user decided.
const data = JSON.parse(document.getElementById("data").textContent);
const cards = [...document.querySelectorAll(".place")];
const decided = document.getElementById("decided"), saved = document.getElementById("saved");
let at = -1, isSaved = true;

function go(number) {
  if (!cards.length) return;
  at = Math.min(Math.max(number, 0), cards.length - 1);
  cards.forEach((card, i) => card.classList.toggle("current", i === at));
  cards[at].focus({ preventScroll: true });
  cards[at].scrollIntoView({ block: "start" });
}

// The status of a card changed: `number` cards are decided now.
function changedTo(number, word) {
  isSaved = false;
  saved.textContent = "";
  decided.textContent = `${number} of ${cards.length} ${word}`;
}

function download(content, type, name, text) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([JSON.stringify(content)], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  isSaved = true;
  saved.textContent = `Saved ${text} as ${name} in your downloads.`;
}

// `press` handles a key on a card, and returns whether it has a meaning.
function listen(save, press) {
  cards.forEach((card, i) => card.addEventListener("focusin", () => {
    at = i;
    cards.forEach((each) => each.classList.toggle("current", each === card));
  }));
  isSaved = true;
  document.getElementById("save")?.addEventListener("click", save);
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input[type=text], select")) return;
    const key = event.key.toLowerCase();
    if (key === "n") go(at + 1);
    else if (key === "p") go(at - 1);
    else if (key === "s") { if (!event.repeat) save(); }
    else if (at < 0 || !press(cards[at], key)) return;
    event.preventDefault();
  });
  window.addEventListener("beforeunload", (event) => { if (!isSaved) event.preventDefault(); });
  document.documentElement.dataset.ready = "yes";
}
