// What a reader of a clip's page does: goes to its end, back, and ten frames on.
const box = document.getElementById("curves"), now = document.getElementById("now");
const key = name => box.dispatchEvent(new KeyboardEvent("keydown", {key: name}));
const said = [box.querySelectorAll("svg").length, box.querySelectorAll("rect.interval").length > 0];
key("End");
said.push(now.textContent.split(",")[0]);
key("Home");
key("PageUp");
said.push(now.textContent.split(":")[0], box.getAttribute("aria-valuenow"));
said.push(document.documentElement.scrollWidth <= innerWidth);
document.body.dataset.said = JSON.stringify(said);
