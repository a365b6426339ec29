// Writes ../three.min.js: the parts of three.js that parts.js names, in one script, with version and licence on top.
import { readFileSync, statSync } from "node:fs";
import { createRequire } from "node:module";
import { buildSync } from "esbuild";

const folder = createRequire(import.meta.url).resolve("three").replace(/build.*/, "");
const { version } = JSON.parse(readFileSync(`${folder}package.json`, "utf8"));
const licence = readFileSync(`${folder}LICENSE`, "utf8").trim();
const outfile = "../three.min.js";
buildSync({
  entryPoints: ["parts.js"],
  outfile,
  bundle: true,
  minify: true,
  format: "iife",
  globalName: "THREE",
  target: "es2020",
  charset: "ascii",
  legalComments: "none", // the one licence stands in the banner
  banner: { js: `/*! three.js ${version}, the parts that relax uses\n\n${licence.replace(/[^\x00-\x7f]/g, "(c)")}\n*/` },
});
console.log(`three.js ${version}: ${statSync(outfile).size} bytes`);
