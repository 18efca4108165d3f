// Opens every page in frames of two widths and reports what a reader would stumble over, one line a fault.
const widths = [390, 1440];
const faults = [];
let opened = 0;
let formulas = 0;

function load(page, width) {
    return new Promise(function (resolve) {
        const frame = document.createElement('iframe');
        frame.width = width;
        frame.height = 900;
        frame.style.border = 0;
        frame.onload = function () { resolve(frame); };
        frame.src = '/' + page;
        document.body.appendChild(frame);
    });
}

// Text that is neither code nor what KaTeX keeps for screen readers.
function running(root) {
    const silent = 'code, pre, script, style, .katex, noscript, title';
    const walker = root.ownerDocument.createTreeWalker(root, NodeFilter.SHOW_TEXT);
    const parts = [];
    while (walker.nextNode()) {
        const parent = walker.currentNode.parentElement;
        if (parent && !parent.closest(silent)) {
            parts.push(walker.currentNode.data);
        }
    }
    return parts.join(' ');
}

// Whether an ancestor scrolls by itself, so that what sticks out of it does not widen the page.
function scrolls(element, view) {
    for (let at = element.parentElement; at; at = at.parentElement) {
        const style = view.getComputedStyle(at);
        if (style.overflowX !== 'visible' || style.position === 'fixed') {
            return true;
        }
    }
    return false;
}

async function look(page, width) {
    const frame = await load(page, width);
    const view = frame.contentWindow;
    const pageDocument = frame.contentDocument;
    const fault = function (what) { faults.push(page + ' at ' + width + ' px: ' + what); };
    await pageDocument.fonts.ready;
    opened += 1;
    const main = pageDocument.querySelector('main') || pageDocument.body;
    if (!main || main.textContent.trim().length < 100) {
        fault('nearly empty');
    }
    const marked = pageDocument.querySelectorAll('.formula');
    const rendered = pageDocument.querySelectorAll('.formula .katex');
    formulas += rendered.length;
    if (marked.length !== rendered.length) {
        fault(marked.length - rendered.length + ' formulas are not rendered');
    }
    pageDocument.querySelectorAll('.katex-error').forEach(function (error) {
        fault('formula: ' + error.title);
    });
    const raw = running(main).match(/.{0,20}(\$|\^\{|\\[a-zA-Z]+\{|\\math).{0,20}/);
    if (raw) {
        fault('raw formula: ' + raw[0]);
    }
    pageDocument.querySelectorAll('img').forEach(function (image) {
        if (image.complete && image.naturalWidth === 0) {
            fault('picture missing: ' + image.src);
        }
    });
    if (pageDocument.documentElement.scrollWidth > width + 1) {
        const wide = Array.from(main.querySelectorAll('*')).find(function (element) {
            return element.getBoundingClientRect().right > width + 1 && !scrolls(element, view);
        });
        const what = wide ? wide.tagName + ' ' + wide.textContent.trim().slice(0, 40) : '?';
        fault('wider than the window: ' + pageDocument.documentElement.scrollWidth + ' (' + what + ')');
    }
    const paragraph = main.querySelector('p');
    if (paragraph && parseFloat(view.getComputedStyle(paragraph).fontSize) < 14) {
        fault('text smaller than 14 px');
    }
    frame.remove();
}

window.onload = async function () {
    for (const page of pages) {
        for (const width of widths) {
            await look(page, width);
        }
    }
    const seen = opened + ' views of pages and ' + formulas + ' formulas';
    await fetch('/report', { method: 'POST', body: faults.concat([seen]).join('\n') });
};
