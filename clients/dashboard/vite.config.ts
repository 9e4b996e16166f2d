import { fileURLToPath } from "node:url";
import { defineConfig } from "vitest/config";

// `npm run dev` asks a running server for everything but the page's own files.
const server = process.env.ADVERB_ADDRESS ?? "http://127.0.0.1:8000";

export default defineConfig({
  // The client is part of this repository; the page bundles its sources.
  resolve: { alias: { "adverb-client": fileURLToPath(new URL("../typescript/src/index.ts", import.meta.url)) } },
  build: {
    outDir: "../../service/static",
    emptyOutDir: true,
    sourcemap: false,
    target: "es2022",
    chunkSizeWarningLimit: 900,
    rolldownOptions: { checks: { pluginTimings: false } },
  },
  worker: { format: "es" },
  server: {
    host: "127.0.0.1",
    proxy: {
      "/v1": { target: server, ws: true },
      "^/(docs|metrics|readyz|openapi.json)$": { target: server },
    },
  },
  test: { environment: "node", include: ["src/**/*.test.ts"], testTimeout: 60_000 },
});
