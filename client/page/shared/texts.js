// Everything that the page says, in English and German. {0}, {1} … are values that are put in. What the server says, such as
// the reason of an error, is in English.

export const GERMAN = {
  // The page's head
  "Skip to the content": "Zum Inhalt",
  Sections: "Bereiche",
  Maps: "Karten",
  Map: "Karte",
  "Try it": "Ausprobieren",
  Record: "Aufnehmen",
  Jobs: "Aufträge",
  Job: "Auftrag",
  Recordings: "Aufnahmen",
  Cameras: "Kameras",
  "Nothing here": "Hier ist nichts",
  "To the maps": "Zu den Karten",

  // The API key, errors, dialogs
  "API key": "API-Schlüssel",
  Key: "Schlüssel",
  "My key": "Mein Schlüssel",
  "It is kept in this browser.": "Er bleibt in diesem Browser.",
  "Whoever runs the server makes one: rholoc key create NAME --scope map":
    "Wer den Server betreibt, erstellt einen: rholoc key create NAME --scope map",
  "Use this key": "Diesen Schlüssel verwenden",
  "This browser uses the key {0}": "Dieser Browser verwendet den Schlüssel {0}",
  "Another key": "Anderer Schlüssel",
  "Remove the key": "Schlüssel entfernen",
  "Type a key, or remove the one that is stored.": "Einen Schlüssel eingeben oder den gespeicherten entfernen.",
  "This page continues by itself when it is back.": "Sobald er wieder erreichbar ist, geht es hier von selbst weiter.",
  "Try again": "Erneut versuchen",
  Cancel: "Abbrechen",
  Back: "Zurück",
  Done: "Fertig",
  "Something went wrong.": "Etwas ist schiefgegangen.",
  "by name": "nach Name",
  "by file name": "nach Dateiname",
  "the newest first": "die neuesten zuerst",
  "the largest first": "die größten zuerst",
  "those in doubt first": "die zweifelhaften zuerst",
  Search: "Suchen",
  Order: "Reihenfolge",

  // Trust
  trusted: "vertrauenswürdig",
  "not trusted": "nicht vertrauenswürdig",
  "not checked": "nicht geprüft",
  "poses given": "Posen vorgegeben",
  "published, not trusted": "fertig, nicht vertrauenswürdig",
  "{0} (not trusted)": "{0} (nicht vertrauenswürdig)",
  Trust: "Vertrauenswürdigkeit",
  "This map passed its checks.": "Diese Karte hat ihre Prüfungen bestanden.",
  "Its poses came with the recording.": "Ihre Posen stammen aus der Aufnahme.",
  "Nothing else has checked this map: it is as right as they are.":
    "Sonst wurde diese Karte durch nichts geprüft: Sie ist so genau wie diese Posen.",
  "Do not rely on this map.": "Auf diese Karte ist kein Verlass.",
  "Nothing has checked this map.": "Diese Karte wurde nicht geprüft.",
  "What to do:": "Was zu tun ist:",
  "In figures": "In Zahlen",
  "Reconstructed twice from different pictures, the walk came out in two different shapes: somewhere the map is wrong.":
    "Zwei Rekonstruktionen aus verschiedenen Bildern ergeben zwei verschiedene Rundgänge: Irgendwo ist die Karte falsch.",
  "Reconstructed twice from different pictures, the walk came out in the same shape.":
    "Zwei Rekonstruktionen aus verschiedenen Bildern ergeben denselben Rundgang.",
  "Too little of the walk could be reconstructed a second time to check its shape.":
    "Vom Rundgang ließ sich zu wenig ein zweites Mal rekonstruieren, um seine Form zu prüfen.",
  "Measure that point again, correct it, and map the recording again.":
    "Diesen Punkt neu messen, seine Koordinaten berichtigen und aus der Aufnahme noch einmal eine Karte erstellen.",
  "Check the points that are missed: mistyped, exchanged, or marked elsewhere? Correct them in the recording, and map it again.":
    "Die verfehlten Punkte prüfen: vertippt, vertauscht oder anderswo markiert? In der Aufnahme berichtigen und aus ihr noch einmal eine Karte erstellen.",
  "Record the walk again: slowly, sideways rather than turning on the spot, and back to where you began. Measured points let the map check itself.":
    "Den Rundgang noch einmal aufnehmen: langsam, eher seitwärts gehend als auf der Stelle drehend, und zurück zum Anfang. Mit gemessenen Punkten prüft sich die Karte selbst.",
  "Build it again with this version to have it checked.": "Mit dieser Version neu erstellen, damit sie geprüft wird.",

  // Maps
  "Upload a map": "Karte hochladen",
  "Record a walk": "Rundgang aufnehmen",
  "Upload a recording": "Aufnahme hochladen",
  "No maps yet": "Noch keine Karten",
  "One walk through a room with a phone makes a map.":
    "Ein Rundgang mit dem Telefon durch einen Raum ergibt eine Karte.",
  "No map matches.": "Keine Karte passt dazu.",
  "{0} from above": "{0} von oben",
  "no unit of length": "ohne Längeneinheit",
  "not upright": "nicht aufrecht",
  "Expected error": "Erwarteter Fehler",
  unknown: "unbekannt",
  Size: "Größe",
  "{0} landmarks, {1}": "{0} Landmarken, {1}",
  Made: "Erstellt",
  Version: "Version",
  "File (.rho or .csv)": "Datei (.rho oder .csv)",
  Upload: "Hochladen",
  "The map is uploaded.": "Die Karte wurde hochgeladen.",

  // A name that a map has already
  "Name of the map": "Name der Karte",
  Name: "Name",
  "There is a map {0}. What is to be done?": "Es gibt eine Karte {0}. Was soll geschehen?",
  "The map learns it, and keeps what it knows": "Die Karte lernt sie dazu und behält, was sie weiß",
  "The map is replaced; the one before can be restored":
    "Die Karte wird ersetzt; die vorige lässt sich wiederherstellen",
  "Use another name": "Anderen Namen verwenden",

  // One map
  "Landmarks and walk of the map {0}": "Landmarken und Rundgang der Karte {0}",
  "Where it works": "Wo sie funktioniert",
  "The room": "Der Raum",
  "No measurement fixed this map's unit of length: positions are not metres.":
    "Keine Messung bestimmt die Längeneinheit dieser Karte: Positionen sind keine Meter.",
  "On the next walk": "Beim nächsten Rundgang",
  Details: "Einzelheiten",
  Landmarks: "Landmarken",
  Views: "Ansichten",
  Features: "Merkmale",
  Densities: "Dichten",
  "For developers": "Für Entwickler",
  File: "Datei",
  Camera: "Kamera",
  "Learned from": "Gelernt aus",
  "It learns from those who use it: {0} queries are kept.":
    "Sie lernt von denen, die sie benutzen: {0} Anfragen sind aufbewahrt.",
  "It no longer learns from those who use it; {0} queries are kept.":
    "Sie lernt nicht mehr von denen, die sie benutzen; {0} Anfragen sind aufbewahrt.",
  "From {0} on it can learn.": "Ab {0} kann sie daraus lernen.",
  "It is learning now.": "Sie lernt gerade.",
  "On {0} it learned nothing: {1}": "Am {0} hat sie nichts gelernt: {1}",
  "It last learned on {0}: {1} landmarks are new, {2} are gone.":
    "Zuletzt gelernt hat sie am {0}: {1} Landmarken sind neu, {2} sind weg.",
  "With version {0} it learned: {1} landmarks are new, {2} are gone.":
    "Mit Version {0} hat sie gelernt: {1} Landmarken sind neu, {2} sind weg.",
  "Of queries held back for a test it placed {0} before and {1} after.":
    "Von Anfragen, die für eine Probe zurückgehalten waren, fand sie vorher {0} und danach {1}.",
  Waypoints: "Wegpunkte",
  Export: "Exportieren",
  "How good it is": "Wie gut sie ist",
  "How well it agrees with itself": "Wie gut sie mit sich übereinstimmt",
  "Held out": "Zurückgehalten",
  "{0} of {1} frames localized": "{0} von {1} Bildern lokalisiert",
  Median: "Median",
  "Median turn": "Median des Winkels",
  "90 % within": "90 % innerhalb von",
  "Frames of the walk that the map was not made from. If the walk as a whole is bent, they do not show it.":
    "Bilder des Rundgangs, aus denen die Karte nicht erstellt wurde. Ist der Rundgang als Ganzes verbogen, zeigen sie das nicht.",
  "No frames were held out of it.": "Keine Bilder wurden zurückgehalten.",
  "Against measured points": "Vergleich mit gemessenen Punkten",
  Points: "Punkte",
  Worst: "Größte Abweichung",
  "No measured point checks it.": "Kein gemessener Punkt prüft sie.",
  "Replaced the map of {0}, version {1}": "Ersetzt die Karte vom {0}, Version {1}",
  "Restore it": "Wiederherstellen",
  "Restore the previous map?": "Vorige Karte wiederherstellen?",
  "It comes back under this name. The present one is kept in its place, and can be restored in turn.":
    "Sie ist dann wieder unter diesem Namen da. Die jetzige bleibt dafür erhalten und lässt sich ebenso wiederherstellen.",
  Restore: "Wiederherstellen",
  "{0} frames": "{0} Bilder",
  "poses {0}": "Posen {0}",
  "Off by": "Abweichung",
  Format: "Format",
  Download: "Herunterladen",
  "the map itself (.rho)": "die Karte selbst (.rho)",
  "cameras and points for COLMAP and Gaussian splatting (.zip)":
    "Kameras und Punkte für COLMAP und Gaussian Splatting (.zip)",
  "densities (.csv)": "Dichten (.csv)",
  "observations (.csv)": "Beobachtungen (.csv)",
  "walk (.csv)": "Rundgang (.csv)",
  "cameras for nerfstudio (.json)": "Kameras für nerfstudio (.json)",
  "landmarks (.ply)": "Landmarken (.ply)",
  "landmarks (.vtp)": "Landmarken (.vtp)",
  "landmarks in colour, for Blender and the web (.glb)": "farbige Landmarken, für Blender und das Web (.glb)",
  More: "Mehr",
  Update: "Aktualisieren",
  Merge: "Zusammenführen",
  Rename: "Umbenennen",
  Delete: "Löschen",
  Forget: "Vergessen",
  "Rename the map": "Karte umbenennen",
  "Delete the map?": "Karte löschen?",
  "The map {0} is deleted for good. Recordings are kept.":
    "Die Karte {0} wird endgültig gelöscht. Aufnahmen bleiben erhalten.",
  "There is no other map to merge with.": "Es gibt keine andere Karte zum Zusammenführen.",
  "Merge with another map": "Mit einer anderen Karte zusammenführen",
  "The other map comes into this one's frame. They must overlap.":
    "Die andere Karte wird in das Koordinatensystem dieser Karte übertragen. Beide müssen sich überlappen.",
  "Other map": "Andere Karte",
  "There is no recording yet. Upload one, and choose to update this map.":
    "Es gibt noch keine Aufnahme. Bitte eine hochladen und dabei wählen, dass diese Karte sie dazulernt.",
  "Learn a further recording": "Weitere Aufnahme dazulernen",
  Recording: "Aufnahme",
  "Forget a recording?": "Aufnahme vergessen?",
  "What the map learned from {0} is taken out of it.": "Was die Karte aus {0} gelernt hat, wird entfernt.",

  // Where it works
  "The map has no views, so it is unknown where it works.":
    "Die Karte hat keine Ansichten; deshalb ist nicht bekannt, wo sie funktioniert.",
  "Point at a place, or use the arrow keys; a click shows it in the room.":
    "Auf einen Ort zeigen oder die Pfeiltasten benutzen; ein Klick zeigt ihn im Raum.",
  "Near the walk, a camera sees {0} landmarks or more in {1} % of all places and directions, and in at least one direction at {2} % of the places.":
    "In der Nähe des Rundgangs sieht eine Kamera an {1} % aller Orte und Blickrichtungen mindestens {0} Landmarken; an {2} % der Orte gilt das für wenigstens eine Richtung.",
  "it works": "es funktioniert",
  "it may fail": "es kann fehlschlagen",
  "it will fail": "es schlägt fehl",
  "At {0} {1}, looking {2}°: {3} landmarks in view; {4}.":
    "Bei {0} {1}, Blickrichtung {2}°: {3} Landmarken im Bild; {4}.",
  "Walk here next:": "Als Nächstes hier entlanggehen:",
  "around {0} {1}, looking to {2}° (the arrow).": "bei {0} {1}, Blickrichtung {2}° (der Pfeil).",
  "Record it": "Aufnehmen",
  fewer: "weniger",
  units: "Einheiten",
  " units": " Einheiten",
  "Landmarks in view": "Landmarken im Bild",

  // The room
  "{0}. Arrow keys turn, shift and arrow keys move, plus and minus zoom, Home resets, Enter picks what is in the middle.":
    "{0}. Pfeiltasten drehen, mit Umschalttaste verschieben sie, Plus und Minus zoomen, Pos1 setzt zurück, die Eingabetaste wählt, was in der Mitte ist.",
  Surfaces: "Flächen",

  // What a map refused
  Refused: "Abgelehnt",
  "Refused in {0}": "Abgelehnt in {0}",
  "Nothing was refused": "Nichts wurde abgelehnt",
  "Pictures that this map refuses in the next day are shown here, as far as they are kept.":
    "Bilder, die diese Karte innerhalb eines Tages ablehnt, stehen hier, soweit sie aufbewahrt werden.",
  "By cause": "Nach Ursache",
  "By robot": "Nach Roboter",
  "By hour": "Nach Stunde",
  "Refused pictures": "Abgelehnte Bilder",
  "No view of the map resembles it.": "Keine Ansicht der Karte ähnelt ihm.",
  "This map keeps no pictures to show beside it.":
    "Diese Karte bewahrt keine Bilder auf, die sich daneben zeigen ließen.",
  "Compare with the map": "Mit der Karte vergleichen",
  "too little texture": "zu wenig Struktur",
  "other light": "anderes Licht",
  "focal length": "Brennweite",
  rolled: "gekippt",
  gravity: "Schwerkraft",
  "relative poses": "relative Posen",
  "too little time": "zu wenig Zeit",
  "inexact map": "ungenaue Karte",
  "too inexact": "zu ungenau",
  "another place": "anderer Ort",

  // Sites and keys
  Sites: "Standorte",
  "New site": "Neuer Standort",
  "Maps of rooms and floors in one frame: one plan, one pose for a whole building.":
    "Karten von Räumen und Stockwerken in einem System: ein Plan und eine Pose für das ganze Gebäude.",
  "No sites yet": "Noch keine Standorte",
  "A site is made of two maps or more.": "Ein Standort besteht aus zwei Karten oder mehr.",
  "{0} maps on {1} floors": "{0} Karten auf {1} Stockwerken",
  "{0} without a place": "{0} ohne Platz",
  "Without a place": "Ohne Platz",
  "Link for visitors": "Link für Besucher",
  "Choose maps": "Karten wählen",
  "Nothing has a place yet": "Noch nichts hat seinen Platz",
  'Rooms get their place by links: "Place them" looks for overlaps.':
    "Räume erhalten ihren Platz durch Verbindungen: „Platz finden“ sucht Überschneidungen.",
  "Where rooms overlap, their place is found from pictures of one that are recognised in another.":
    "Wo Räume sich überschneiden, ergibt sich ihr Platz aus Bildern des einen, die im anderen erkannt werden.",
  "Place them": "Platz finden",
  "Floor {0}": "Stockwerk {0}",
  "Floor of {0}": "Stockwerk von {0}",
  "Delete the site?": "Standort löschen?",
  "{0}. Its maps stay.": "{0}. Seine Karten bleiben.",
  "Whoever has the link finds the way in this site with a phone's camera until it expires, and can do nothing else.":
    "Wer den Link hat, findet sich an diesem Standort mit der Kamera eines Telefons zurecht, bis er abläuft, und kann sonst nichts.",
  Keys: "Schlüssel",
  "find the way in a site": "den Weg an einem Standort finden",
  "look at everything": "alles ansehen",
  "ask for poses, too": "auch nach Posen fragen",
  "make and change maps, too": "auch Karten erstellen und ändern",
  everything: "alles",
  "Requests a second": "Anfragen je Sekunde",
  "Bytes stored": "Gespeicherte Bytes",
  "Jobs at once": "Aufträge zugleich",
  "New key": "Neuer Schlüssel",
  "For whom or what": "Für wen oder was",
  "Name points": "Punkte benennen",
  "Keys without an end are made on the server, with rholoc key create. Those that are made here expire.":
    "Unbefristete Schlüssel erstellt man auf dem Server mit rholoc key create. Die von hier laufen ab.",
  "This server asks nobody for a key, or has given out none.":
    "Dieser Server verlangt keinen Schlüssel oder hat noch keinen ausgegeben.",
  "No keys yet": "Noch keine Schlüssel",
  expired: "abgelaufen",
  " of {0}": " ({0})",
  "Without an end": "Unbefristet",
  "Until {0}": "Bis {0}",
  ", handed on by {0}": ", weitergegeben von {0}",
  Limits: "Grenzen",
  "Limits of {0}": "Grenzen von {0}",
  Revoke: "Widerrufen",
  "It holds {0} maps, {1} and {2} jobs.": "Er hält {0} Karten, {1} und {2} Aufträge.",
  "empty: no limit": "leer: keine Grenze",
  "Revoke the key?": "Schlüssel widerrufen?",
  "{0}, and all keys that it handed on, are refused from now on.":
    "{0} und alle Schlüssel, die damit weitergegeben wurden, gelten ab sofort nicht mehr.",
  "It may": "Er darf",
  Days: "Tage",
  "Make the key": "Schlüssel erstellen",
  "This server needs no key.": "Dieser Server braucht keinen Schlüssel.",
  "It is not shown again.": "Er wird nicht noch einmal gezeigt.",

  // The visitor's page
  "Point the camera around you.": "Die Kamera einmal umherblicken lassen.",
  "Plan of the floor": "Plan des Stockwerks",
  "Show me where I am": "Zeigen, wo ich bin",
  "Lead me to": "Führe mich zu",
  nowhere: "nirgendwohin",
  "Pictures go to this site's own server, and are not kept.":
    "Die Bilder gehen an den Server dieses Standorts und werden nicht aufbewahrt.",
  "I do not know where you are. Point the camera around you.":
    "Ich weiß nicht, wo Sie sind. Lassen Sie die Kamera umherblicken.",
  "You are here, give or take {0} m.": "Sie sind hier, auf etwa {0} m genau.",
  "{0} is on another floor: {1}.": "{0} ist auf einem anderen Stockwerk: {1}.",
  "No walk leads from here to {0}.": "Kein bekannter Weg führt von hier zu {0}.",
  "You are there: {0}.": "Sie sind da: {0}.",
  "Turn left.": "Nach links drehen.",
  "Turn right.": "Nach rechts drehen.",
  "{0} m, then left": "{0} m, dann links",
  "{0} m, then right": "{0} m, dann rechts",
  "{0} m straight on": "{0} m geradeaus",

  "expected error ": "erwarteter Fehler ",
  "Both reconstructions": "Beide Rekonstruktionen",
  "the walk in this map": "der Rundgang in dieser Karte",
  "in a second reconstruction: where they drift apart, the map may be wrong":
    "in einer zweiten Rekonstruktion: Wo sie auseinandergehen, kann die Karte falsch sein",
  "A robot here, looking there, is right to about {0}.":
    "Ein Roboter, der hier steht und dorthin blickt, liegt auf etwa {0} richtig.",
  "From above": "Von oben",
  "Whole room": "Ganzer Raum",
  "Levelled for display: up is estimated": "Für die Anzeige aufgerichtet: Wo oben ist, ist geschätzt",
  "Show {0} more points": "{0} weitere Punkte zeigen",
  "Landmarks only": "Nur Landmarken",
  "Picture before": "Vorheriges Bild",
  "Next picture": "Nächstes Bild",
  "What the camera saw there": "Was die Kamera dort sah",
  "uncertainty ": "Unsicherheit ",
  "Colour by uncertainty": "Nach Unsicherheit färben",
  "Colours of the pictures": "Farben der Bilder",
  "Seen in {0} pictures; it is looked for within the cone.":
    "In {0} Bildern gesehen; gesucht wird sie innerhalb des Kegels.",
  "Landmark at {0} {1}, known to {2}": "Landmarke bei {0} {1}, auf {2} genau bekannt",
  "Picture {0} of the walk, from {1} {2}, looking {3}°": "Bild {0} des Rundgangs, von {1} {2}, Blickrichtung {3}°",

  // Jobs
  "No jobs yet": "Noch keine Aufträge",
  "A job makes a map of each recording that is uploaded.":
    "Aus jeder hochgeladenen Aufnahme erstellt ein Auftrag eine Karte.",
  "Progress of {0}": "Fortschritt von {0}",
  "Map {0}": "Karte {0}",
  "Site {0}": "Standort {0}",
  "Not all maps of the site are placed.": "Nicht alle Karten des Standorts sind eingeordnet.",
  "Give a link or a pose, or map what lies between them.":
    "Geben Sie eine Verbindung oder eine Pose an, oder nehmen Sie auf, was dazwischen liegt.",
  Priority: "Vorrang",
  high: "hoch",
  normal: "normal",
  low: "niedrig",
  "To the map": "Zur Karte",
  Queued: "Eingereiht",
  Took: "Dauer",
  Attempts: "Versuche",
  Log: "Protokoll",
  "Nothing yet.": "Noch nichts.",
  queued: "wartet",
  running: "läuft",
  published: "fertig",
  failed: "fehlgeschlagen",
  cancelled: "abgebrochen",
  received: "empfangen",
  read: "gelesen",
  keyframes: "Schlüsselbilder",
  features: "Merkmale",
  poses: "Posen",
  observations: "Beobachtungen",
  densities: "Dichten",
  report: "Bericht",
  links: "Verbindungen",

  // Recordings
  "Stored recordings": "Gespeicherte Aufnahmen",
  "A video, or a recording as a ZIP file.": "Ein Video oder eine Aufnahme als ZIP-Datei.",
  "{0} of {1}": "{0} von {1}",
  "{0} It continues by itself.": "{0} Es geht von selbst weiter.",
  "Upload a walk": "Rundgang hochladen",
  "No recordings yet": "Noch keine Aufnahmen",
  "They are kept after their map is made, so that a job can be tried again and other maps can learn them.":
    "Sie bleiben erhalten, auch wenn ihre Karte fertig ist: So lässt sich ein Auftrag wiederholen, und andere Karten können sie dazulernen.",
  Files: "Dateien",
  "Map and job": "Karte und Auftrag",
  Uploaded: "Hochgeladen",
  Actions: "Aktionen",
  " and {0} more": " und {0} weitere",
  "{0} and {1} more": "{0} und {1} weitere",
  "Delete the recording?": "Aufnahme löschen?",
  "{0}, {1}. Maps made of it stay.": "{0}, {1}. Daraus erstellte Karten bleiben erhalten.",

  // Cameras
  "Width, px": "Breite, px",
  "Height, px": "Höhe, px",
  "Add a camera": "Kamera hinzufügen",
  "A camera's intrinsics under a name. The command rholoc camera calibrate finds them from a filmed board.":
    "Die intrinsischen Parameter einer Kamera unter einem Namen. Der Befehl rholoc camera calibrate bestimmt sie aus einem Film einer Kalibriertafel.",
  "No cameras yet": "Noch keine Kameras",
  "Frames of the map's own camera need none.":
    "Bilder der Kamera, mit der die Karte aufgenommen wurde, brauchen keine.",
  "distortion {0}": "Verzeichnung {0}",
  "no distortion": "keine Verzeichnung",
  Lens: "Objektiv",
  pinhole: "Lochkamera",
  fisheye: "Fischauge",
  panorama: "Panorama",
  " · off by {0} px": " · Abweichung {0} px",
  Change: "Ändern",
  "Change the camera": "Kamera ändern",
  "Distortion k1, k2, p1, p2, k3": "Verzeichnung k1, k2, p1, p2, k3",
  "empty: none; of a fisheye k1, k2, k3, k4": "leer: keine; eines Fischauges k1, k2, k3, k4",
  Store: "Speichern",
  "Delete the camera?": "Kamera löschen?",
  "{0}. Maps that were made with it keep it.": "{0}. Karten, die mit ihr aufgenommen wurden, behalten sie.",

  // Try it
  "No map to try": "Keine Karte zum Ausprobieren",
  "Make one of a walk first.": "Zuerst aus einem Rundgang eine Karte erstellen.",
  "The map {0} and the pose that was found": "Die Karte {0} und die gefundene Pose",
  "No picture yet": "Noch kein Bild",
  "The pose appears here.": "Hier erscheint die Pose.",
  "such as 65": "z. B. 65",
  "Try all maps": "Alle Karten probieren",
  "Most confident of all maps:": "Von allen Karten am sichersten:",
  "No map localizes this picture.": "Keine Karte lokalisiert dieses Bild.",
  "Show the landscape around the pose": "Landschaft um die Pose zeigen",
  Landscape: "Landschaft",
  "Play the ascents": "Aufstiege abspielen",
  "Too little in the picture matches to climb by.": "Im Bild passt zu wenig zur Karte, um daran aufzusteigen.",
  "Positions around the pose, {0} {1} wide, from above: the brighter, the better they explain the picture. {2} ascents.":
    "Positionen um die Pose, {0} {1} breit, von oben: je heller, desto besser erklären sie das Bild. {2} Aufstiege.",
  "No pose, but the best optimum: positions around it, {0} {1} wide, from above. {2} ascents.":
    "Keine Pose, aber das beste Optimum: Positionen darum herum, {0} {1} breit, von oben. {2} Aufstiege.",
  "Localizing …": "Wird lokalisiert …",
  "Type the picture's horizontal field of view, or choose a camera.":
    "Das waagrechte Blickfeld des Bildes eingeben oder eine Kamera wählen.",
  "The picture; it has no pose": "Das Bild; es hat keine Pose",
  "The picture with {0} features that the map recognised":
    "Das Bild mit {0} Merkmalen, die die Karte wiedererkannt hat",
  localized: "lokalisiert",
  "no pose": "keine Pose",
  Position: "Position",
  Heading: "Blickrichtung",
  "Off by about": "Abweichung etwa",
  "Focal length": "Brennweite",
  "{0} px, estimated to {1} px": "{0} px, auf {1} px geschätzt",
  Matches: "Zuordnungen",
  "{0} of {1} agree": "{0} von {1} stimmen überein",
  "confidence unknown": "Konfidenz unbekannt",
  "right place over {0} %": "richtiger Ort über {0} %",
  "right place {0} %": "richtiger Ort {0} %",
  "confidence over {0} %": "Konfidenz über {0} %",
  "confidence {0} %": "Konfidenz {0} %",
  "The map itself is not trusted: the pose may be wrong by more than is said here.":
    "Die Karte selbst ist nicht vertrauenswürdig: Die Pose kann weiter danebenliegen, als hier angegeben ist.",
  "The field of view was typed, not measured: a few degrees off put the pose decimetres off. Calibrate the camera to know.":
    "Das Blickfeld wurde eingegeben, nicht gemessen: Schon wenige Grad Abweichung verschieben die Pose um Dezimeter. Gewissheit gibt eine kalibrierte Kamera.",
  "The camera is not known; its focal length was estimated from this picture alone. A stored camera is more reliable.":
    "Die Kamera ist nicht bekannt; ihre Brennweite wurde allein aus diesem Bild geschätzt. Eine gespeicherte Kamera ist zuverlässiger.",
  "The picture has another shape than the camera's. It is taken to be the same camera, turned or cropped; if it is not, the pose is wrong.":
    "Das Bild hat ein anderes Seitenverhältnis als die der Kamera. Angenommen wird dieselbe Kamera, gedreht oder beschnitten; stimmt das nicht, ist die Pose falsch.",
  "The request as a program": "Die Anfrage als Programm",
  "Copy as {0}": "Als {0} kopieren",
  "Copied.": "Kopiert.",
  "Select the text below and copy it.": "Den Text unten markieren und kopieren.",
  "All routes": "Alle Routen",
  "Camera options": "Kameraoptionen",
  "Horizontal field of view, °": "Waagrechtes Blickfeld, °",
  "of the picture, from its left to its right edge": "des Bildes, von seinem linken zu seinem rechten Rand",
  "Which camera took it?": "Welche Kamera hat es aufgenommen?",
  "not specified: the map's if the shape matches, otherwise estimated":
    "keine Angabe: die der Karte bei gleichem Seitenverhältnis, sonst geschätzt",
  "the camera that made the map": "die Kamera, mit der die Karte aufgenommen wurde",
  "unknown: estimate its focal length": "unbekannt: Brennweite schätzen",
  "another, by its field of view": "eine andere, nach ihrem Blickfeld",
  "hand-held: the camera may roll": "in der Hand gehalten: Die Kamera kann seitlich geneigt sein",
  "Drop a picture, a video or a trajectory (CSV) here":
    "Ein Bild, ein Video oder eine Trajektorie (CSV) hierher ziehen",
  "Picture, video or trajectory": "Bild, Video oder Trajektorie",
  "Use the camera": "Kamera verwenden",
  "Stop the camera": "Kamera anhalten",
  "Stop the video": "Video anhalten",
  "track from frame to frame": "von Bild zu Bild verfolgen",
  "This file is not a video that the browser can play.": "Diese Datei ist kein Video, das der Browser abspielen kann.",
  searching: "sucht noch",
  tracking: "verfolgt",
  lost: "verloren",
  stopped: "angehalten",
  "Too long without an answer of use: the pose is a guess.":
    "Zu lange keine brauchbare Antwort: Die Pose ist nur geschätzt.",
  "The pose jumped by {0}. The track before it may be wrong.":
    "Die Pose ist um {0} gesprungen. Der Weg davor kann falsch sein.",
  Answers: "Antworten",
  "{0} of use, {1} left aside": "{0} brauchbar, {1} verworfen",
  "Last answer": "Letzte Antwort",
  Jumps: "Sprünge",
  Rate: "Rate",
  "Choose a file": "Datei wählen",
  "This file is not a picture that the browser can read.": "Diese Datei ist kein Bild, das der Browser lesen kann.",
  "{0} frames a second": "{0} Bilder in der Sekunde",
  "The camera needs HTTPS: start the server with rholoc serve --tls.":
    "Die Kamera braucht HTTPS: den Server mit rholoc serve --tls starten.",
  Trajectory: "Trajektorie",
  "{0} poses": "{0} Posen",
  Lasts: "Dauer",
  Time: "Zeit",
  Pause: "Pause",
  Play: "Abspielen",
  "This is not a trajectory: it has no column {0}.": "Das ist keine Trajektorie: Die Spalte {0} fehlt.",
  "Line {0} contains something other than numbers: {1}": "Zeile {0} enthält etwas anderes als Zahlen: {1}",
  "The trajectory has no rows.": "Die Trajektorie hat keine Zeilen.",

  // The recorder: before the walk
  "New recording": "Neue Aufnahme",
  "Measured points": "Gemessene Punkte",
  "Before the first walk": "Vor dem ersten Rundgang",
  "Got it": "Verstanden",
  "For the map {0}: begin where it works, walk to about {1}, {2}, look to {3}°, and come back. Before sending, choose that the map learns it.":
    "Für die Karte {0}: dort beginnen, wo sie funktioniert, bis etwa {1}, {2} gehen, in Richtung {3}° blicken und zurückkommen. Vor dem Senden wählen, dass die Karte die Aufnahme dazulernt.",
  "Walk slowly, and sideways where you can; do not turn on the spot. Keep things in view: furniture, posters, shelves, no bare walls.":
    "Langsam und möglichst seitwärts gehen, sich nicht auf der Stelle drehen. Dinge im Bild behalten: Möbel, Plakate, Regale, keine kahlen Wände.",
  "Come back to where you began, and look at it again as you did then: the loop shows the map its own errors.":
    "Zum Anfang zurückkommen und ihn wieder so ansehen wie zu Beginn: Die Schleife zeigt der Karte ihre eigenen Fehler.",
  "Optional: measure three points or more, not on one line. Stand still at each for two seconds, and mark it.":
    "Wer mag: drei oder mehr Punkte ausmessen, die nicht auf einer Geraden liegen. An jedem zwei Sekunden still stehen und ihn markieren.",
  "Measured points (optional)": "Gemessene Punkte (freiwillig)",
  "Open the camera": "Kamera öffnen",
  "On this phone": "Auf diesem Telefon",
  "This phone's storage is almost full: {0} left. A minute takes about 60 MB.":
    "Der Speicher dieses Telefons ist fast voll: {0} frei. Eine Minute braucht etwa 60 MB.",
  "broken off": "abgebrochen",
  "not sent": "nicht gesendet",
  "not sent yet": "noch nicht gesendet",
  sent: "gesendet",
  "Look at it": "Ansehen",
  "Go on sending": "Senden fortsetzen",
  "See its job": "Zum Auftrag",
  "Remove from the list": "Aus der Liste entfernen",
  "Delete this recording?": "Diese Aufnahme löschen?",
  "It is only on this phone.": "Sie ist nur auf diesem Telefon.",
  "The camera was refused.": "Der Zugriff auf die Kamera wurde verweigert.",
  "Allow it for this page in the browser's settings, then try again.":
    "Bitte in den Einstellungen des Browsers für diese Seite erlauben und es noch einmal versuchen.",
  "There is no camera.": "Es gibt keine Kamera.",
  "Open this page on a phone.": "Diese Seite auf einem Telefon öffnen.",
  "Another program has the camera.": "Ein anderes Programm verwendet die Kamera.",
  "Close it and try again.": "Bitte dieses schließen und es noch einmal versuchen.",
  "The camera does not start.": "Die Kamera startet nicht.",
  "This browser stores nothing for this page.": "Dieser Browser speichert nichts für diese Seite.",
  "Leave private browsing and try again.": "Bitte den privaten Modus verlassen und es noch einmal versuchen.",
  "Leave private browsing and try again. ({0})":
    "Bitte den privaten Modus verlassen und es noch einmal versuchen. ({0})",
  "Browsers give the camera to pages over HTTPS only.": "Browser geben die Kamera nur für Seiten über HTTPS frei.",
  "Film the walk with the phone's camera app and upload the video. Or start the server with rholoc serve --tls, and open the address that it prints.":
    "Den Rundgang mit der Kamera-App des Telefons filmen und das Video hochladen. Oder den Server mit rholoc serve --tls starten und die Adresse öffnen, die er ausgibt.",
  "This browser cannot record video.": "Dieser Browser kann kein Video aufnehmen.",
  "Use a recent Chrome, Safari or Firefox.": "Bitte eine aktuelle Version von Chrome, Safari oder Firefox verwenden.",
  "The motion sensors were refused.": "Der Zugriff auf die Bewegungssensoren wurde verweigert.",
  "With them the map knows its size and what is up. Allow motion and orientation for this page, or record video alone.":
    "Mit ihnen kennt die Karte ihre Größe und weiß, was oben ist. Bitte Bewegung und Ausrichtung für diese Seite erlauben oder nur Video aufnehmen.",
  "Record video alone": "Nur Video aufnehmen",

  // The recorder: while walking
  "The camera's picture": "Das Bild der Kamera",
  "Sensors …": "Sensoren …",
  "Sensors {0} Hz": "Sensoren {0} Hz",
  "No {0}: video only": "Kein {0}: nur Video",
  ", no ": ", kein ",
  accelerometer: "Beschleunigungssensor",
  gyroscope: "Gyroskop",
  "No motion sensors: video only": "Keine Bewegungssensoren: nur Video",
  Stop: "Anhalten",
  "Mark a point:": "Punkt markieren:",
  "Points ({0})": "Punkte ({0})",
  Light: "Licht",
  Texture: "Struktur",
  Sharpness: "Schärfe",
  Calm: "Ruhe",
  "Too fast. Turn more slowly.": "Zu schnell. Langsamer drehen.",
  "Too dark. Turn on a light.": "Zu dunkel. Licht einschalten.",
  "Nothing new in view. Walk on.": "Nichts Neues im Bild. Weitergehen.",
  "The camera saw only one view: it stood still. A map needs a walk through the room.":
    "Die Kamera hat nur eine Ansicht gesehen: Sie stand still. Eine Karte braucht einen Rundgang durch den Raum.",
  "Blurred. Slow down, or wipe the lens.": "Unscharf. Langsamer gehen oder die Linse abwischen.",
  "Nothing to recognise here. Turn to something with texture, or step back.":
    "Hier ist nichts zu erkennen. Die Kamera auf etwas mit Struktur richten oder zurücktreten.",
  "Hold the phone upright.": "Das Telefon aufrecht halten.",
  "The motion sensors report {0} times a second; {1} are needed.":
    "Die Bewegungssensoren melden {0} Werte in der Sekunde; {1} sind nötig.",
  "Recording ended when you left this page: a phone shuts the camera off then. What came before is kept.":
    "Die Aufnahme endete mit dem Verlassen der Seite: Ein Telefon schaltet die Kamera dann ab. Was vorher kam, ist erhalten.",
  "Recording ended when the phone was turned: a recording has one shape. What came before is kept.":
    "Die Aufnahme endete, als das Telefon gedreht wurde: Hoch- und Querformat gehen nicht in einer Aufnahme. Was vorher kam, ist erhalten.",
  "Recording ended because this phone has no space left. What came before is kept.":
    "Die Aufnahme endete, weil der Speicher dieses Telefons voll ist. Was vorher kam, ist erhalten.",
  "Recording broke off. What came before is kept.": "Die Aufnahme wurde unterbrochen. Was vorher kam, ist erhalten.",
  "Recording ended because the camera went away. What came before is kept.":
    "Die Aufnahme endete, weil die Kamera nicht mehr verfügbar war. Was vorher kam, ist erhalten.",

  // The recorder: measured points
  "Name of point {0}": "Name von Punkt {0}",
  "not marked": "nicht markiert",
  "Unmark {0}": "Markierung von {0} entfernen",
  "Remove {0}": "{0} entfernen",
  Remove: "Entfernen",
  "{0} of {1} in metres": "{0} von {1} in Metern",
  "Add a point": "Punkt hinzufügen",
  "{0} of at least {1} points are marked and measured. Without more the map gets axes of its own.":
    "{0} von mindestens {1} Punkten sind markiert und gemessen. Mit so wenigen bekommt die Karte eigene Achsen.",
  "Where the camera is at a point, in metres, z up. Three or more that are not on one line give the map your axes; without them it has its own.":
    "Wo die Kamera an einem Punkt ist, in Metern, z nach oben. Drei oder mehr, die nicht auf einer Geraden liegen, geben der Karte Ihre Achsen; ohne sie hat sie eigene.",
  "Two waypoints are called {0}.": "Zwei Wegpunkte heißen {0}.",
  "The waypoints lie on one line, so the rotation about it is not determined. Measure one more off that line, or clear their coordinates.":
    "Die Wegpunkte liegen auf einer Geraden; die Drehung um sie bleibt offen. Bitte einen weiteren abseits davon messen oder ihre Koordinaten löschen.",

  // The recorder: before sending
  "Your recording": "Ihre Aufnahme",
  "The recording": "Die Aufnahme",
  "{0} s is too short for a map: walk for at least {1} s, half a minute or more for a room.":
    "{0} s sind zu kurz für eine Karte: wenigstens {1} s gehen, für einen Raum eine halbe Minute oder mehr.",
  "Seconds that will fail": "Unbrauchbare Sekunden",
  "They are {0} of the walk: better walk again.": "Das sind {0} des Rundgangs: besser noch einmal gehen.",
  "turned too fast": "zu schnell gedreht",
  "too dark": "zu dunkel",
  blurred: "unscharf",
  "nothing to recognise": "nichts zu erkennen",
  "No motion sensors: the map's scale comes from measured points alone.":
    "Keine Bewegungssensoren: Den Maßstab der Karte bestimmen allein gemessene Punkte.",
  "The motion sensors reported {0} times a second; {1} are needed.":
    "Die Bewegungssensoren meldeten {0} Werte in der Sekunde; {1} sind nötig.",
  "Parts of it are dark. The map may have gaps there.":
    "Teile der Aufnahme sind dunkel. Dort kann die Karte Lücken haben.",
  Recorded: "Aufgenommen",
  Length: "Länge",
  "without times": "ohne Zeiten",
  Sensors: "Sensoren",
  none: "keine",
  "Darkest light": "Dunkelstes Licht",
  "Unknown: estimated while mapping": "Unbekannt: wird beim Erstellen der Karte geschätzt",
  Send: "Senden",
  "Record again": "Noch einmal aufnehmen",
  "Save as a file": "Als Datei speichern",
  Later: "Später",

  // The recorder: sending
  Sending: "Wird gesendet",
  Progress: "Fortschritt",
  "Getting ready …": "Wird vorbereitet …",
  "You may close this page: sending continues when you open it again.":
    "Sie können diese Seite schließen: Das Senden geht weiter, wenn Sie sie wieder öffnen.",
  "You may close this page: the server goes on by itself.":
    "Sie können diese Seite schließen: Der Server macht von selbst weiter.",
  "For the map {0}": "Für die Karte {0}",
  "{0} of {1}, {2}": "{0} von {1}, {2}",
  "The server cannot be reached.": "Der Server ist nicht erreichbar.",
  "Nothing is lost: sending continues by itself when it can.":
    "Nichts ist verloren: Das Senden geht von selbst weiter.",
  "The page continues by itself when it can.": "Sobald es möglich ist, geht es von selbst weiter.",
  "Not started yet.": "Noch nicht begonnen.",
  "The server makes the map": "Der Server erstellt die Karte",
  "Sent. It is no longer needed on this phone.": "Gesendet. Auf diesem Telefon wird sie nicht mehr gebraucht.",
  "Waiting for its turn": "Wartet, bis sie an der Reihe ist",
  Received: "Empfangen",
  "Reading the recording": "Aufnahme lesen",
  "Choosing pictures": "Bilder auswählen",
  "Finding what can be recognised": "Wiedererkennbares suchen",
  "Finding where each picture was taken": "Aufnahmeort jedes Bildes bestimmen",
  "Comparing the pictures": "Bilder vergleichen",
  "Learning what is seen from where": "Lernen, was von wo zu sehen ist",
  "Testing the map": "Karte prüfen",
  Published: "Fertig",
  "Comparing the maps": "Karten vergleichen",
  "less than a minute left": "noch weniger als eine Minute",
  "about a minute left": "noch etwa eine Minute",
  "about {0} minutes left": "noch etwa {0} Minuten",
  "about {0} hours left": "noch etwa {0} Stunden",
  "Try it with a few pictures from where it will be used. Its page shows where it works less well, and where to walk next.":
    "Probieren Sie sie mit einigen Bildern von dort aus, wo sie gebraucht wird. Ihre Seite zeigt, wo sie weniger gut ist und wo Sie als Nächstes gehen sollten.",
  "The map is ready": "Die Karte ist fertig",
  "The map is made, but do not rely on it": "Die Karte ist fertig, aber auf sie ist kein Verlass",
  "See the map": "Karte ansehen",
  "Correct the points": "Punkte berichtigen",
  "Walk again": "Noch einmal gehen",
  "Record another": "Weitere aufnehmen",
  "The job was cancelled": "Der Auftrag wurde abgebrochen",
  "Mapping failed": "Die Karte konnte nicht erstellt werden",
  "The server keeps the recording.": "Der Server behält die Aufnahme.",
  "All jobs": "Alle Aufträge",
  "It could not be sent": "Sie konnte nicht gesendet werden",
  "The recording is still on this phone.": "Die Aufnahme ist noch auf diesem Telefon.",
  "Change it": "Ändern",

  // A map made right
  "Make it right": "Berichtigen",
  "Make {0} right": "{0} berichtigen",
  "From the south": "Von Süden",
  "From the east": "Von Osten",
  Origin: "Ursprung",
  "Click the point that is to be (0, 0), or type it. From a side, its height.":
    "Den Punkt anklicken, der (0, 0) sein soll, oder ihn eintippen. Von der Seite: seine Höhe.",
  "Axis along a wall": "Achse an einer Wand",
  "Drag along a wall: x will point that way.": "An einer Wand entlangziehen: Dorthin zeigt dann x.",
  North: "Norden",
  "Drag towards the north: y will point that way.": "Nach Norden ziehen: Dorthin zeigt dann y.",
  Upright: "Lotrecht",
  "From a side, drag upwards along something vertical, such as the edge of a door. Then the same from the other side.":
    "Von der Seite an etwas Senkrechtem nach oben ziehen, etwa an einer Türkante. Dann dasselbe von der anderen Seite.",
  "Level by the pictures": "Nach den Bildern ausrichten",
  "Estimates what is up from how the camera was held: to a few degrees.":
    "Schätzt aus der Haltung der Kamera, wo oben ist: auf wenige Grad genau.",
  Distance: "Abstand",
  "Drag from one end of something measured to the other, and type its true length.":
    "Von einem Ende einer gemessenen Strecke zum anderen ziehen und ihre wahre Länge eintippen.",
  "True length, m": "Wahre Länge, m",
  "Floor plan": "Grundriss",
  "Open a plan, then click a point of the map and the same point of the plan, twice.":
    "Einen Grundriss öffnen, dann einen Punkt der Karte und denselben Punkt des Grundrisses anklicken, zweimal.",
  "Crop or delete a region": "Zuschneiden oder Bereich löschen",
  "Drag a rectangle, or click corner after corner.": "Ein Rechteck aufziehen oder Ecke für Ecke anklicken.",
  "delete what is inside": "löschen, was darin liegt",
  "keep only what is inside": "nur behalten, was darin liegt",
  Do: "Aktion",
  "Only above z =": "Nur oberhalb von z =",
  "Only below z =": "Nur unterhalb von z =",
  "Delete a piece of the walk": "Ein Stück des Rundgangs löschen",
  "Drag along the piece of the walk that is to go.": "An dem Stück des Rundgangs entlangziehen, das weg soll.",
  "Name a point": "Einen Punkt benennen",
  "Click the point, and type its name.": "Den Punkt anklicken und seinen Namen eintippen.",
  "Name an area": "Einen Bereich benennen",
  Kind: "Art",
  "More: name=value, …": "Weiteres: Name=Wert, …",
  "room, door, charger": "Raum, Tür, Ladestation",
  "Save names as GeoJSON": "Namen als GeoJSON speichern",
  "Open a file": "Eine Datei öffnen",
  Open: "Öffnen",
  "What the file has": "Was die Datei enthält",
  "GeoJSON, an IMDF archive, or a ZIP file with the yaml and picture of a map_server.":
    "GeoJSON, ein IMDF-Archiv oder eine ZIP-Datei mit dem yaml und dem Bild eines map_server.",
  "Level of an IMDF archive": "Ebene eines IMDF-Archivs",
  "Drag a rectangle, or click corner after corner, and type its name.":
    "Ein Rechteck aufziehen oder Ecke für Ecke anklicken und den Namen eintippen.",
  origin: "Ursprung",
  north: "Norden",
  "axis along a wall": "Achse an einer Wand",
  upright: "lotrecht",
  scale: "Maßstab",
  "laid over a plan": "auf einen Grundriss gelegt",
  "region removed": "Bereich entfernt",
  "piece of the walk removed": "Stück des Rundgangs entfernt",
  names: "Namen",
  "The map {0}, to draw on. Arrow keys move, plus and minus zoom, Home shows all of it.":
    "Die Karte {0} zum Zeichnen. Pfeiltasten verschieben, Plus und Minus vergrößern und verkleinern, Pos1 zeigt alles.",
  "What is to be corrected?": "Was soll berichtigt werden?",
  Apply: "Anwenden",
  Clear: "Verwerfen",
  "{0} on the map": "{0} auf der Karte",
  "{0} of {1} landmarks inside": "{0} von {1} Landmarken darin",
  "Pictures {0} to {1} of {2}": "Bilder {0} bis {1} von {2}",
  "A to B: {0} on the map, {1} on the plan; each point is off by {2} unless the map is scaled.":
    "A bis B: {0} auf der Karte, {1} auf dem Grundriss; jeder Punkt liegt um {2} daneben, wenn die Karte nicht skaliert wird.",
  from: "von",
  to: "bis",
  "Corners: x y, x y, …": "Ecken: x y, x y, …",
  "First picture": "Erstes Bild",
  "Last picture": "Letztes Bild",
  "Done. The version before can be restored.": "Erledigt. Die vorige Version lässt sich wiederherstellen.",
  Names: "Namen",
  point: "Punkt",
  area: "Bereich",
  "Restored. The version before can be restored in turn.":
    "Wiederhergestellt. Die Version davor lässt sich ebenso wiederherstellen.",
  Versions: "Versionen",
  "Now: version {0}": "Jetzt: Version {0}",
  "No earlier version is kept.": "Es gibt keine frühere Version.",
  "Version {0}, of {1}": "Version {0}, vom {1}",
  "What was corrected": "Was berichtigt wurde",
  "Version {0}: {1}, {2}": "Version {0}: {1}, {2}",
  ", off by {0}": ", um {0} daneben",
  "{0} is neither a picture nor GeoJSON.": "{0} ist weder ein Bild noch GeoJSON.",
  "The file is not JSON.": "Die Datei ist kein JSON.",
  "The GeoJSON has no lines or areas.": "Das GeoJSON enthält keine Linien oder Flächen.",
  "GeoJSON has degrees: longitude and latitude.": "GeoJSON steht in Grad: Länge und Breite.",
  "Picture or GeoJSON": "Bild oder GeoJSON",
  "It is kept with the map.": "Er wird mit der Karte gespeichert.",
  "The floor plan": "Der Grundriss",
  "floor plan": "Grundriss",
  "place on Earth": "Ort auf der Erde",
  "Remove the plan": "Grundriss entfernen",
  "Width of the plan, m": "Breite des Grundrisses, m",
  "Without it, the map's own scale counts.": "Ohne sie gilt der Maßstab der Karte.",
  "The map takes the plan's scale": "Die Karte übernimmt den Maßstab des Grundrisses",

  // Live, and where it failed
  Live: "Live",
  Who: "Wer",
  Pose: "Pose",
  Uncertainty: "Unsicherheit",
  Asks: "Anfragen",
  "Nobody asks for poses at the moment.": "Zurzeit fragt niemand nach Posen.",
  "Asking for poses: {0}.": "Zurzeit fragen nach Posen: {0}.",
  "{0} s ago": "vor {0} s",
  "{0} a second": "{0} pro Sekunde",
  "No request failed here in the last day, as far as this server knows.":
    "In den letzten 24 Stunden schlug hier keine Anfrage fehl, soweit dieser Server weiß.",
  "Requests of the last day without a pose: {0}, with an unsure one: {1}.":
    "Anfragen der letzten 24 Stunden ohne Pose: {0}, mit unsicherer Pose: {1}.",
  "The drawing glows where they came from.": "Wo sie herkamen, leuchtet die Zeichnung.",
  "Of {0} nobody knows where they came from.": "Bei {0} weiß niemand, woher sie kamen.",

  // Links with a key
  Share: "Teilen",
  "Share a link": "Link teilen",
  "one day": "einen Tag",
  "{0} days": "{0} Tage",
  "Whoever has the link can look at all maps of this server until it expires, and change nothing.":
    "Wer den Link hat, kann bis zu dessen Ablauf alle Karten dieses Servers ansehen und nichts ändern.",
  "Valid for": "Gültig für",
  "Make the link": "Link erstellen",
  Link: "Link",
  Copy: "Kopieren",
  "Valid until {0}.": "Gültig bis {0}.",
  "This server needs no key: the link does not expire.":
    "Dieser Server verlangt keinen Schlüssel: Der Link läuft nicht ab.",
  "This address leads others nowhere: the server listens on this machine alone.":
    "Unter dieser Adresse erreicht ihn sonst niemand: Der Server ist nur auf diesem Rechner erreichbar.",
  "QR code of the link": "QR-Code des Links",
  "Go on with a phone": "Mit einem Telefon weitermachen",
  "A walk is recorded with a phone: this computer's camera does not walk.":
    "Ein Rundgang wird mit einem Telefon aufgenommen: Mit diesem Rechner geht niemand herum.",
  "Show a QR code": "QR-Code zeigen",
  "Film the walk with the phone's camera app, and upload the video here.":
    "Den Rundgang mit der Kamera-App des Telefons filmen und das Video hier hochladen.",
  "To record in the phone's browser, with its motion sensors, start the server with rholoc serve --tls, and open the address that it prints here: it shows a QR code for the phone.":
    "Um im Browser des Telefons aufzunehmen, mit dessen Bewegungssensoren, den Server mit rholoc serve --tls starten und die Adresse, die er ausgibt, hier öffnen: Dann zeigt diese Seite einen QR-Code für das Telefon.",
  "Point the phone's camera at it.": "Die Kamera des Telefons darauf richten.",
  "Point the phone's camera at it. The key in it is valid for two hours.":
    "Die Kamera des Telefons darauf richten. Der Schlüssel darin gilt zwei Stunden.",

  // While walking
  "{0} of {1} directions seen, different views: {2}, loops closed: {3}":
    "{0} von {1} Richtungen gesehen, verschiedene Ansichten: {2}, geschlossene Schleifen: {3}",
  "You have been here before: hold still for two seconds.": "Hier waren Sie schon: zwei Sekunden still stehen bleiben.",
  "No loop was seen: the walk did not come back to where it had been, or not long enough. The map will not know its own errors.":
    "Keine Schleife gesehen: Der Rundgang kam nicht dorthin zurück, wo er schon war, oder nicht lange genug. Die Karte kennt dann ihre eigenen Fehler nicht.",

  // Lists in groups, and one recording
  "not at all": "gar nicht",
  Group: "Gruppieren",
  "the others": "die übrigen",
  "by site": "nach Standort",
  "by floor": "nach Stockwerk",
  "by tag": "nach Stichwort",
  "by map": "nach Karte",
  "the longest first": "die längsten zuerst",
  Place: "Ort",
  Tags: "Stichwörter",
  Site: "Standort",
  Floor: "Stockwerk",
  "Site, floor, tags": "Standort, Stockwerk, Stichwörter",
  "site, floor, tags": "Standort, Stockwerk, Stichwörter",
  "The list of maps is searched and grouped by them.":
    "Die Liste der Karten lässt sich danach durchsuchen und gruppieren.",
  "Words with commas between": "Wörter, durch Kommas getrennt",
  Save: "Speichern",
  "All recordings": "Alle Aufnahmen",
  "A picture of the recording": "Ein Bild der Aufnahme",
  Picture: "Bild",
  Frames: "Bilder",
  Motion: "Bewegung",
  "accelerometer and gyroscope": "Beschleunigungs- und Drehratensensor",
  "not recorded": "nicht aufgezeichnet",
  "No job has mapped it.": "Kein Auftrag hat sie kartiert.",
  "Take back": "Zurücknehmen",
  "These were typed here and take the place of the recording's own.":
    "Diese wurden hier eingegeben und gelten anstelle derer der Aufnahme.",
  "As they came with the recording.": "So, wie sie mit der Aufnahme kamen.",
  "Saved. The recording is mapped with them from now on; maps that there are stay as they are.":
    "Gespeichert. Die Aufnahme wird von nun an mit ihnen kartiert; vorhandene Karten bleiben, wie sie sind.",
  "Time, s": "Zeit, s",
  "Within, m": "Genau auf, m",
  "Without a time, the camera paused at each in this order. Three or more, not on one line.":
    "Ohne Zeit hielt die Kamera in dieser Reihenfolge an jedem an. Mindestens drei, nicht auf einer Geraden.",
  "In the area": "Im Bereich",
  "Near the point": "Beim Punkt",
  "Add a waypoint": "Wegpunkt hinzufügen",
  "Save waypoints": "Wegpunkte speichern",
  "as the recording says": "wie in der Aufnahme angegeben",
  "Map it": "Kartieren",
  "Map it again": "Noch einmal kartieren",
  "Only these frames": "Nur diese Bilder",
  "From and to, by number; empty for all": "Von und bis, nach Nummer; leer für alle",
};

// Sentences of the server, as it says them in English; tests/page looks whether it still does.
export const GERMAN_OF_SERVER = {
  "The server does not answer.": "Der Server antwortet nicht.",
  "Check the connection and try again.": "Bitte die Verbindung prüfen und es noch einmal versuchen.",
  "The server answered with status {0}.": "Der Server hat mit dem Status {0} geantwortet.",
  "The connection broke off.": "Die Verbindung ist abgebrochen.",
  "waiting for a worker: none is running": "wartet auf einen Worker: Es läuft keiner",
  "waiting for a worker with {0} of memory for it: none has more than {1}":
    "wartet auf einen Worker mit {0} Speicher: Keiner hat mehr als {1}",
  "waiting for a worker": "wartet auf einen freien Worker",
  "the worker died {0} times in a row: {1}": "Der Worker brach {0}-mal nacheinander ab: {1}",
  "{0} of {1} pairs of pictures matched": "{0} von {1} Bildpaaren verglichen",
  "all measurements adjusted together": "alle Messungen werden gemeinsam ausgeglichen",
  "adjusted anew": "neu ausgeglichen",
  "{0} of {1} pairs of views": "{0} von {1} Paaren von Ansichten",
  "{0} of {1} frames held out, for consistency": "{0} von {1} zurückgehaltenen Bildern geprüft",
  "This picture does not show this map: nothing in it looks like anything there.":
    "Dieses Bild zeigt diese Karte nicht: Nichts darin gleicht etwas von dort.",
  "This picture does not show this map: {0} of {1} matches agree, no better than chance.":
    "Dieses Bild zeigt diese Karte nicht: {0} von {1} Zuordnungen stimmen überein, nicht mehr als durch Zufall.",
  "Too little in this picture shows this map to be sure of the place: {0} of {1} matches agree.":
    "Zu wenig in diesem Bild zeigt diese Karte, um des Ortes sicher zu sein: {0} von {1} Zuordnungen stimmen überein.",
  "Check that it is the right map, and look where the recording looked; or extend the map by a walk from here.":
    "Prüfen, ob es die richtige Karte ist, und dorthin sehen, wohin die Aufnahme sah; oder die Karte um einen Rundgang von hier erweitern.",
  "The picture is nearly black: its mean grey level is {0} of 255.":
    "Das Bild ist fast schwarz: Sein mittlerer Grauwert ist {0} von 255.",
  "Switch on a light, or let the camera expose longer while it stands still.":
    "Licht einschalten oder die Kamera länger belichten lassen, während sie still steht.",
  "The picture is blurred.": "Das Bild ist unscharf.",
  "Hold the camera still for the next picture, or shorten its exposure.":
    "Die Kamera beim nächsten Bild still halten oder kürzer belichten.",
  "Its light is unlike that of the map's recording (mean grey level {0}, the recording's {1}).":
    "Das Licht ist anders als in der Aufnahme der Karte (mittlerer Grauwert {0}, in der Aufnahme {1}).",
  "Its light is unlike that of the map's recording.": "Das Licht ist anders als in der Aufnahme der Karte.",
  "Check that it is the right map; if it is, extend it by a walk in this light.":
    "Prüfen, ob es die richtige Karte ist; wenn ja, sie um einen Rundgang bei diesem Licht erweitern.",
  "The picture shows hardly anything but a bare surface.": "Das Bild zeigt kaum mehr als eine kahle Fläche.",
  "Turn the camera towards furniture, pictures or shelves.": "Die Kamera auf Möbel, Bilder oder Regale richten.",
  "The place was recognized, but the pose is only known to {0} (1σ); at most {1} was asked for.":
    "Der Ort wurde erkannt, aber die Pose ist nur auf {0} (1σ) bekannt; verlangt waren höchstens {1}.",
  "The place was found, but the map itself may be off by more than half a metre there.":
    "Der Ort wurde gefunden, aber die Karte selbst kann dort um mehr als einen halben Meter danebenliegen.",
  "The camera's focal length looks wrong: about {0} px fits better than {1} px.":
    "Die Brennweite der Kamera sieht falsch aus: Etwa {0} px passen besser als {1} px.",
  "Send the intrinsics of the picture as it is sent, after scaling and cropping; or ask with intrinsics unknown.":
    "Die intrinsischen Parameter des Bildes angeben, wie es nach dem Verkleinern und Zuschneiden ist; oder die Kamera als unbekannt angeben.",
  "The deadline passed before all places were searched.": "Die Zeit war um, bevor alle Orte abgesucht waren.",
  "Allow more time.": "Mehr Zeit erlauben.",
  "The waypoint {0} is missed by {1} m.": "Der Wegpunkt {0} wird um {1} m verfehlt.",
  "This server requires an API key.": "Dieser Server verlangt einen API-Schlüssel.",
  "This API key is unknown, or was revoked.": "Dieser API-Schlüssel ist unbekannt oder wurde widerrufen.",
  "This API key was revoked.": "Dieser API-Schlüssel wurde widerrufen.",
  "This API key has expired.": "Dieser API-Schlüssel ist abgelaufen.",
  "This API key may not do that: its scope is {0}, and {1} is needed.":
    "Dieser API-Schlüssel darf das nicht: Er erlaubt {0}, nötig ist {1}.",
  "Turn slower: a tenth of the walk was above {0}°/s; above {1} pictures blur.":
    "Langsamer drehen: Ein Zehntel des Rundgangs lag über {0}°/s; über {1} werden Bilder unscharf.",
  "Switch on more light: the mean grey is {0} of 255; at least {1} is needed.":
    "Mehr Licht einschalten: Der mittlere Grauwert ist {0} von 255; nötig sind {1}.",
  "Keep more texture in view: {0} of the frames show hardly any corners (bare walls, or blur).":
    "Mehr Strukturen im Bild behalten: {0} der Bilder zeigen kaum Ecken (kahle Wände oder Unschärfe).",
  "reading the recording": "Aufnahme wird gelesen",
  "{0} of {1} frames looked at": "{0} von {1} Bildern angesehen",
  "{0} of {1} pairs of keyframes matched": "{0} von {1} Paaren von Schlüsselbildern verglichen",
  "{0} of {1} keyframes placed": "{0} von {1} Schlüsselbildern eingeordnet",
  "features of {0} of {1} frames": "Merkmale von {0} von {1} Bildern",
  "Stand still for a second at each waypoint: {0} of {1} have a pause, and a place measured in passing is centimetres off.":
    "An jedem Wegpunkt eine Sekunde still stehen: {0} von {1} haben eine Pause, und ein im Gehen gemessener Ort liegt um Zentimeter daneben.",
  "Come back to where you have been, looking the same way: the end of the walk stays {0} of its length off its beginning, and errors grow along an open path.":
    "Dorthin zurückkommen, wo Sie schon waren, mit demselben Blick: Das Ende des Rundgangs bleibt {0} seiner Länge vom Anfang entfernt, und auf einem offenen Weg wachsen Fehler.",
  "The pictures have no times, so the IMU cannot be used: add frames.csv with frame,timestamp.":
    "Die Bilder haben keine Zeiten, daher ist die IMU nicht zu verwenden: frames.csv mit frame,timestamp hinzufügen.",
  "The video ends after {0} of its {1} frames: the file seems cut short.":
    "Das Video endet nach {0} von {1} Bildern: Die Datei scheint abgeschnitten zu sein.",
  "There are {0} gaps between frames, the longest {1} s; the path may break there.":
    "Zwischen Bildern sind {0} Lücken, die längste {1} s; dort kann der Weg abreißen.",
  "The motion sensors cover {0} of the frames; the rest is placed by the images alone.":
    "Die Bewegungssensoren decken {0} der Bilder ab; die übrigen ordnen die Bilder allein ein.",
  "Show more of the room, or closer things, or allow a larger {0}.":
    "Mehr vom Raum oder nähere Dinge zeigen, oder ein größeres {0} erlauben.",
  "Walk there again and update the map, or lower RHOLOC_MIN_RECOGNIZED.":
    "Dort noch einmal entlanggehen und die Karte ergänzen, oder RHOLOC_MIN_RECOGNIZED senken.",
  "Only {0} frames with different views have a pose; a map needs at least {1}.":
    "Nur {0} Bilder mit verschiedenen Ansichten haben eine Pose; eine Karte braucht mindestens {1}.",
  "Record a longer walk, or give poses for more frames.":
    "Einen längeren Rundgang aufnehmen oder Posen für mehr Bilder angeben.",
  "Too few points have a well-known position: {0} of the {1} that a map needs.":
    "Von zu wenigen Punkten ist die Lage gut bekannt: {0} der {1}, die eine Karte braucht.",
  "Walk slowly, farther and sideways rather than turning on the spot, with more light and texture in view.":
    "Langsam gehen, aber weiter und seitwärts statt auf der Stelle zu drehen, mit mehr Licht und Struktur im Bild.",
  "A job is using the recording.": "Ein Auftrag verwendet die Aufnahme.",
  "Cancel the job, or wait until it has ended.": "Den Auftrag abbrechen oder warten, bis er beendet ist.",
  "This link is for another site.": "Dieser Link gilt für einen anderen Standort.",
  "Open the link or the code of this one.": "Bitte den Link oder Code dieses Standorts öffnen.",
  "This room has no place on the plan yet.": "Dieser Raum hat noch keinen Platz auf dem Plan.",
  "There is no map yet.": "Es gibt noch keine Karte.",
  "There is no map {0}.": "Es gibt keine Karte {0}.",
  "There are none yet.": "Es gibt noch keine.",
  "There is already a map {0}.": "Es gibt schon eine Karte {0}.",
  "Choose another name, or delete that map first.": "Einen anderen Namen wählen oder jene Karte zuerst löschen.",
  "The map {0} was changed in the meantime.": "Die Karte {0} wurde inzwischen geändert.",
  "Try again: the change will start from the new one.":
    "Noch einmal versuchen: Die Änderung beginnt dann mit der neuen.",
  "There is no landmark to remove.": "Es gibt keine Landmarke zu entfernen.",
  "Choose another region.": "Eine andere Fläche wählen.",
  "Only {0} landmarks would be left.": "Nur {0} Landmarken blieben übrig.",
  "Remove less, or delete the map instead.": "Weniger entfernen oder stattdessen die Karte löschen.",
  "This is not an image that can be read.": "Das ist kein lesbares Bild.",
  "Send a whole JPEG, PNG or WebP file.": "Eine vollständige JPEG-, PNG- oder WebP-Datei senden.",
  "Too many large requests are in progress.": "Zu viele große Anfragen sind gerade in Arbeit.",
  "Try again after Retry-After.": "Bitte gleich noch einmal versuchen.",
  "This server does not show who asks for poses.": "Dieser Server zeigt nicht, wer nach Posen fragt.",
  "This server keeps no refused pictures.": "Dieser Server bewahrt keine abgelehnten Bilder auf.",
  "The refused picture {0} is no longer kept.": "Das abgelehnte Bild {0} wird nicht mehr aufbewahrt.",
  "The maps of the site {0} are being placed already.":
    "Für die Karten des Standorts {0} wird schon ein Platz gesucht.",
  "Wait for the job {0}.": "Bitte auf den Auftrag {0} warten.",
  "There is no picture of the recording yet.": "Von der Aufnahme gibt es noch kein Bild.",
  "The mapping process ended unexpectedly ({0}).": "Das Erstellen der Karte endete unerwartet ({0}).",
  "It may have run out of memory: retry, record a shorter walk, or give the worker more memory.":
    "Vielleicht fehlte Speicher: noch einmal versuchen, einen kürzeren Rundgang aufnehmen oder dem Worker mehr geben.",
  "Mapping took longer than the limit of {0} s.": "Das Erstellen der Karte dauerte länger als die erlaubten {0} s.",
  "On the server, rholoc key create NAME --scope {0} makes one.":
    "Auf dem Server erstellt rholoc key create NAME --scope {0} einen.",
  "There is already a key called {0}.": "Es gibt schon einen Schlüssel namens {0}.",
  "The recording's own poses {0}; its pictures were used.":
    "Die Posen der Aufnahme wurden nicht verwendet ({0}), sondern ihre Bilder.",
  "came without intrinsics": "sie kamen ohne intrinsische Parameter",
  "The recording's own poses, adjusted to its pictures by {0} in the median.":
    "Die Posen der Aufnahme, an ihre Bilder angeglichen um {0} im Median.",
  "The poses were given.": "Die Posen waren gegeben.",
  "Integrated from the IMU alone; nothing checks it between the waypoints.":
    "Allein aus der IMU integriert; zwischen den Wegpunkten prüft es nichts.",
  "The accelerometer contradicts the pictures.": "Der Beschleunigungsmesser widerspricht den Bildern.",
  "Pictures and IMU agree.": "Bilder und IMU stimmen überein.",
  "The accelerometer measured gravity.": "Der Beschleunigungsmesser hat die Schwerkraft gemessen.",
};
