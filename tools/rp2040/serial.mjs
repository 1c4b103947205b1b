// The other ends of serial lines, named as QEMU does: null, stdio, file:PATH, pty, unix:PATH,server=on,wait=on,
// unix:PATH,server=off.
import { spawn } from 'node:child_process';
import { existsSync, openSync, unlinkSync, writeSync } from 'node:fs';
import net from 'node:net';
import { fileURLToPath } from 'node:url';

/** Nobody: what is sent is gone. */
class Nobody {
    start() {}
    write() {}
    flush() {}
    close() {}
    get isPeer() {
        return false;
    }
}

/** Bytes are collected while the chip runs, and go out together. */
class Buffered {
    constructor() {
        this.bytes = [];
    }

    write(byte) {
        this.bytes.push(byte);
    }

    flush() {
        if (this.bytes.length > 0) {
            this.send(Buffer.from(this.bytes));
            this.bytes = [];
        }
    }

    close() {}

    get isPeer() {
        return true;
    }
}

class Stdio extends Buffered {
    start(onData) {
        process.stdin.on('data', onData);
        process.stdin.on('error', () => {});
        process.stdin.unref?.();
    }

    // Whole, also into a pipe that is full for a while.
    send(bytes) {
        for (let at = 0; at < bytes.length;) {
            try {
                at += writeSync(1, bytes, at);
            } catch (error) {
                if (error.code !== 'EAGAIN') {
                    throw error;
                }
            }
        }
    }

    get isPeer() {
        return false; // it keeps no real time
    }
}

/** Whoever looks later. */
class File extends Buffered {
    constructor(path) {
        super();
        this.path = path;
    }

    start() {
        this.file = openSync(this.path, 'w');
    }

    send(bytes) {
        writeSync(this.file, bytes);
    }

    get isPeer() {
        return false;
    }
}

/** A pseudo-terminal, which Node.js cannot make: its name is told as QEMU tells it. */
class Terminal extends Buffered {
    constructor(label) {
        super();
        this.label = label;
    }

    start(onData) {
        this.helper = spawn('/usr/bin/python3', [fileURLToPath(new URL('pty.py', import.meta.url))]);
        this.helper.stdout.on('data', onData);
        this.helper.stdin.on('error', () => {});
        return new Promise((resolve, reject) => {
            this.helper.on('error', reject);
            this.helper.stderr.once('data', (name) => {
                process.stdout.write(`char device redirected to ${name.toString().trim()} (label ${this.label})\n`);
                resolve();
            });
        });
    }

    send(bytes) {
        this.helper.stdin.write(bytes);
    }

    close() {
        this.helper?.stdin.end();
    }
}

class Socket extends Buffered {
    constructor(path, isServer, waits) {
        super();
        Object.assign(this, { path, isServer, waits, peer: null, server: null });
    }

    start(onData) {
        return this.isServer ? this.listen(onData) : this.connect(onData);
    }

    listen(onData) {
        if (existsSync(this.path)) {
            unlinkSync(this.path);
        }
        return new Promise((resolve, reject) => {
            this.server = net.createServer((peer) => {
                this.take(peer, onData);
                resolve();
            });
            this.server.on('error', reject);
            this.server.listen(this.path, () => this.waits || resolve());
        });
    }

    connect(onData) {
        return new Promise((resolve, reject) => {
            const peer = net.createConnection(this.path, () => {
                this.take(peer, onData);
                resolve();
            });
            peer.on('error', reject);
        });
    }

    take(peer, onData) {
        this.peer = peer;
        peer.on('data', onData);
        peer.on('error', () => {});
        peer.on('close', () => {
            this.peer = this.peer === peer ? null : this.peer;
        });
    }

    send(bytes) {
        this.peer?.write(bytes);
    }

    close() {
        this.peer?.end();
        this.server?.close();
    }
}

/** The end that a text names; null for a text that names none. `label` is what a terminal is told as. */
export function openEnd(text, label) {
    switch (text) {
        case 'null':
            return new Nobody();
        case 'stdio':
            return new Stdio();
        case 'pty':
            return new Terminal(label);
    }
    if (text.startsWith('file:')) {
        return new File(text.slice(5));
    }
    const [path, ...options] = text.startsWith('unix:') ? text.slice(5).split(',') : [''];
    const isServer = options.includes('server=on');
    const known = ['server=on', 'server=off', 'wait=on', 'wait=off'];
    return path === '' || options.some((option) => !known.includes(option))
        ? null
        : new Socket(path, isServer, !options.includes('wait=off'));
}
