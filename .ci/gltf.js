// Khronos' validator on glTF files: fails where one has an error or a warning, or where nothing was looked at.
//
//   NODE_PATH=FOLDER/node_modules node .ci/gltf.js FILE.glb...
"use strict";
const fs = require("node:fs");
const validator = require("gltf-validator");

async function main(files) {
    if (files.length === 0) throw new Error("no files");
    let failed = false;
    for (const file of files) {
        const { issues } = await validator.validateBytes(new Uint8Array(fs.readFileSync(file)));
        const { numErrors, numWarnings, numInfos, numHints } = issues;
        console.log(`${file}: ${numErrors} errors, ${numWarnings} warnings, ${numInfos} notes, ${numHints} hints`);
        const serious = issues.messages.filter((message) => message.severity < 2 || process.env.ALL);
        for (const { code, message, pointer } of serious.slice(0, 10)) console.log(`  ${code} ${pointer}: ${message}`);
        failed ||= numErrors + numWarnings > 0;
    }
    process.exitCode = failed ? 1 : 0;
}

main(process.argv.slice(2)).catch((error) => {
    console.error(String(error));
    process.exitCode = 1;
});
