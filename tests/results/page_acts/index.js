// What a reader of a batch's page does: sorts it twice by name, chooses a verdict, and looks for words.
const rows = () => [...document.querySelectorAll("tbody tr")].filter(row => !row.hidden);
const said = [rows().length, rows()[1].cells[0].textContent];
const heads = document.querySelectorAll("thead button");
heads[0].click();
heads[0].click();
said.push(rows()[0].cells[0].textContent, heads[0].parentElement.getAttribute("aria-sort"));
const kind = document.getElementById("kind"), words = document.getElementById("words");
kind.value = "undetermined";
kind.dispatchEvent(new Event("change"));
words.value = "CLIP 19";
words.dispatchEvent(new Event("input"));
said.push(rows().map(row => row.cells[0].textContent), document.getElementById("counted").textContent);
document.body.dataset.said = JSON.stringify(said);
