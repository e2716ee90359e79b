import { render } from "preact";
import { App } from "./App";
import "./style.css";
import "./camera.css";
import "./figures.css";
import "./pairs.css";
import "./sequence.css";
import "./calibration.css";

const page = document.getElementById("page");
if (page) render(<App />, page);
