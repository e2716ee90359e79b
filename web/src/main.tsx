import { render } from "preact";
import { App } from "./App";
import "./style.css";
import "./camera.css";
import "./figures.css";
import "./pairs.css";

const page = document.getElementById("page");
if (page) render(<App />, page);
