// Khronos' validator on glTF files: fails where one has an error or a warning, or where nothing was looked at.
//
//   NODE_PATH=FOLDER/node_modules node .ci/gltf.js FILE.glb...
//   node .ci/gltf.js --shapes FOLDER      writes sphere.ply, cube.ply and triangle.ply
"use strict";
const fs = require("node:fs");
const path = require("node:path");

function writePly(file, vertices, triangles) {
    const header = ["ply", "format ascii 1.0", `element vertex ${vertices.length}`];
    for (const axis of "xyz") header.push(`property float ${axis}`);
    header.push(`element face ${triangles.length}`, "property list uchar int vertex_indices", "end_header");
    const lines = [...header, ...vertices.map((v) => v.join(" ")), ...triangles.map((t) => `3 ${t.join(" ")}`)];
    fs.writeFileSync(file, lines.join("\n") + "\n");
}

// The faces of a cube of edge 2, each of num x num squares, outward.
function cube(num) {
    const [vertices, triangles] = [[], []];
    for (let face = 0; face < 6; face++) {
        const [axis, side, first] = [face % 3, face < 3 ? 1 : -1, vertices.length];
        for (let v = 0; v <= num; v++)
            for (let u = 0; u <= num; u++) {
                const at = [];
                at[axis] = side;
                at[(axis + 1) % 3] = (2 * u) / num - 1;
                at[(axis + 2) % 3] = (2 * v) / num - 1;
                vertices.push(at);
            }
        for (let v = 0; v < num; v++)
            for (let u = 0; u < num; u++) {
                const a = first + v * (num + 1) + u;
                const [b, c, d] = [a + 1, a + num + 2, a + num + 1];
                for (const t of [[a, b, c], [a, c, d]]) triangles.push(side > 0 ? t : t.reverse());
            }
    }
    return [vertices, triangles];
}

function writeShapes(folder) {
    writePly(path.join(folder, "cube.ply"), ...cube(1));
    const [corners, triangles] = cube(16);
    const round = corners.map((v) => v.map((c) => c / Math.hypot(...v)));
    writePly(path.join(folder, "sphere.ply"), round, triangles);
    // No thicker than a sheet: a mesh without any volume is not photographed.
    const plate = [-0.01, 0.01].flatMap((y) => [[-1, y, -1], [1, y, -1], [0, y, 1]]);
    const sides = [0, 1, 2].flatMap((a) => [[a, a + 3, ((a + 1) % 3) + 3], [a, ((a + 1) % 3) + 3, (a + 1) % 3]]);
    writePly(path.join(folder, "triangle.ply"), plate, [[0, 1, 2], [5, 4, 3], ...sides]);
}

async function main(files) {
    if (files[0] === "--shapes") return writeShapes(files[1]);
    if (files.length === 0) throw new Error("no files");
    const validator = require("gltf-validator");
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
