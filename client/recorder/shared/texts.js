// Everything that the page says, in English and German. A text that is not in here is shown in English.

export const GERMAN = {};
