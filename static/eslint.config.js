import globals from "globals";

export default [
  { ignores: ["vendor/", "node_modules/"] },
  {
    files: ["js/**/*.js"],
    languageOptions: { ecmaVersion: 2023, sourceType: "module", globals: globals.browser },
    rules: {
      "eqeqeq": "error",
      "no-const-assign": "error",
      "no-else-return": "error",
      "no-implicit-globals": "error",
      "no-undef": "error",
      "no-unused-vars": "error",
      "no-var": "error",
      "no-restricted-properties": [
        "error",
        { property: "innerHTML", message: "Text from the server must never become markup." },
      ],
      "object-shorthand": "error",
      "prefer-const": "error",
    },
  },
];
