// A page opened from a folder may not start a Worker; the search then runs in a hidden frame instead.
if (location.protocol === "file:") {
  class IFrameWorker {
    constructor(address) {
      const frame = (this.frame = document.createElement("iframe"));
      frame.hidden = true;
      document.body.appendChild(frame);
      this.inner = frame.contentWindow;
      this.waiting = []; // what is said before the script has been read
      const script = this.inner.document.createElement("script");
      this.inner.postMessage = (data) => {
        const copy = structuredClone(data);
        setTimeout(() => this.onmessage?.(new MessageEvent("message", { data: copy })));
      };
      this.inner.importScripts = (...addresses) =>
        addresses.reduce((before, each) => before.then(() => this.load(each)), Promise.resolve());
      script.src = address;
      script.onload = () => {
        const said = this.waiting;
        this.waiting = null;
        said.forEach((data) => this.tell(data));
      };
      this.inner.document.body.appendChild(script);
    }
    load(address) {
      return new Promise((done, failed) => {
        const script = this.inner.document.createElement("script");
        script.src = address;
        script.onload = done;
        script.onerror = failed;
        this.inner.document.body.appendChild(script);
      });
    }
    tell(data) {
      const copy = this.inner.structuredClone(data);
      this.inner.dispatchEvent(new this.inner.MessageEvent("message", { data: copy }));
    }
    terminate() {
      this.frame.remove();
    }
    postMessage(data) {
      if (this.waiting) this.waiting.push(data);
      else this.tell(data);
    }
  }
  window.IFrameWorker = IFrameWorker;
  window.Worker = IFrameWorker;
}
