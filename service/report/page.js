const report = JSON.parse(document.getElementById("report").textContent);
const plots = document.getElementById("plots");
for (const [name, [title]] of Object.entries(PLOTS)) {
  const heading = document.createElement("h2"), place = document.createElement("div");
  heading.textContent = title;
  plots.append(heading, place);
  show(place, name, report);
}
