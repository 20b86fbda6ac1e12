// @ts-check
// The libraries that draw the page. Only this module, and chart.js for charts, import from ../vendor.

import htm from "../../vendor/htm-3.1.1.module.js";
import { Component, createContext, h, render } from "../../vendor/preact-11.2.0.module.js";
import {
  useCallback,
  useContext,
  useEffect,
  useId,
  useLayoutEffect,
  useMemo,
  useRef,
  useState,
} from "../../vendor/preact-hooks-11.2.0.module.js";

/** Tagged template -> virtual DOM. Text is always text: there is no way to inject HTML. */
const html = htm.bind(h);

export {
  Component,
  createContext,
  h,
  html,
  render,
  useCallback,
  useContext,
  useEffect,
  useId,
  useLayoutEffect,
  useMemo,
  useRef,
  useState,
};
