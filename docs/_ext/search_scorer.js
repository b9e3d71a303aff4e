// Order of search results: a key, check or solver of that very name, the shortest first, then
// pages and sections by their titles, then pages by their text. Pages that list the program's own
// names come last.
var Scorer = {
  score: (result) => {
    const [docname, title, , , score, , kind] = result;
    if (/^generated\/(api|folders)$/.test(docname)) return score / 10;
    if (kind === "object") return score - title.split(".").length / 10;
    const query = new URLSearchParams(window.location.search).get("q") || "";
    return title.toLowerCase().includes(query.toLowerCase().trim()) ? score + 5 : score;
  },
  objNameMatch: 30,
  objPartialMatch: 3,
  objPrio: { 0: 1, 1: 0, 2: -1 },
  objPrioDefault: 0,
  title: 20,
  partialTitle: 6,
  term: 5,
  partialTerm: 2,
};
