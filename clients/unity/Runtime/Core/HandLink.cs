using System;
using System.Collections.Concurrent;
using System.Diagnostics;
using System.Globalization;
using System.IO;
using System.Net.Sockets;
using System.Text;
using System.Threading;
using Newtonsoft.Json;
using Newtonsoft.Json.Linq;

namespace MrNav
{
    /// <summary>Where a connection stands.</summary>
    public enum LinkState
    {
        /// <summary>Nobody answers yet; it is tried again by itself.</summary>
        Connecting,

        /// <summary>This is the rig's hand.</summary>
        InControl,

        /// <summary>The twin comes, but another hand has control.</summary>
        Watching,

        /// <summary>Refused, or told to end: <see cref="HandLink.Start"/> again when that is mended.</summary>
        Ended,
    }

    /// <summary>
    /// One hand's connection to the server (docs/protocol.md, "Hand link"): sends the fingertip, keeps the newest
    /// twin. A background thread reads and connects anew; every member may be used from any thread, none waits.
    /// </summary>
    public sealed class HandLink : IDisposable
    {
        private const int SilenceMs = 2000;
        private const int FirstPauseMs = 100;
        private const int LongestPauseMs = 1000;
        private static readonly double Ticks = Stopwatch.Frequency;

        private readonly string _host;
        private readonly int _port;
        private readonly string _hello;
        private readonly object _sending = new object();
        private readonly ConcurrentQueue<string> _notices = new ConcurrentQueue<string>();
        private readonly ManualResetEvent _ending = new ManualResetEvent(true);
        private Thread _thread;
        private Socket _socket;
        private long _seq;
        private volatile Twin _twin;
        private volatile string _session;
        private volatile string _reason = "";
        private volatile LinkState _state = LinkState.Ended;

        /// <param name="host">Where the server runs.</param>
        /// <param name="port">Its port for hands, 9000 unless set otherwise.</param>
        /// <param name="token">An operator's token.</param>
        /// <param name="client">The name that others see.</param>
        /// <param name="rateHz">How often the twin comes, 1 to 120 Hz.</param>
        /// <param name="simulatedBy">Name of the model that stands in for a person; null for a person.</param>
        public HandLink(
            string host, int port, string token, string client, double rateHz = 60.0, string simulatedBy = null)
        {
            _host = host;
            _port = port;
            var hello = new JObject
            {
                { "type", "hello" }, { "v", 1 }, { "role", "operator" }, { "token", token }, { "client", client },
                { "frame", "unity" }, { "rate_hz", rateHz }, { "simulated", simulatedBy != null },
            };
            if (simulatedBy != null)
            {
                hello["model"] = simulatedBy;
                hello["seed"] = 0;
            }
            _hello = hello.ToString(Formatting.None) + "\n";
        }

        public LinkState State
        {
            get { return _state; }
        }

        /// <summary>Why it is not in control, in plain words; "" while it is.</summary>
        public string Reason
        {
            get { return _reason; }
        }

        /// <summary>The newest twin; null before the first, and after the connection was lost.</summary>
        public Twin Twin
        {
            get { return _twin; }
        }

        /// <summary>A secret under which <see cref="RigApi"/> asks with this hand's authority; null without one.</summary>
        public string Session
        {
            get { return _session; }
        }

        /// <summary>Monotonic seconds: the clock of the messages.</summary>
        public static double NowS
        {
            get { return Stopwatch.GetTimestamp() / Ticks; }
        }

        /// <summary>Connect, and stay connected until <see cref="Dispose"/> or a refusal.</summary>
        public void Start()
        {
            if (_state != LinkState.Ended)
            {
                return;
            }
            _ending.Reset();
            _state = LinkState.Connecting;
            _thread = new Thread(Run) { IsBackground = true, Name = "mrnav hand link" };
            _thread.Start();
        }

        /// <summary>Hang up: the rig holds.</summary>
        public void Dispose()
        {
            _ending.Set();
            Hang();
            if (_thread != null && _thread != Thread.CurrentThread)
            {
                _thread.Join(SilenceMs);
            }
            _state = LinkState.Ended;
        }

        /// <summary>Say hello anew, for example after another took control over and gave it back.</summary>
        public void Renew()
        {
            Hang();
            Start();
        }

        /// <summary>Take the next thing that an operator should know, in plain words.</summary>
        public bool TryTakeNotice(out string notice)
        {
            return _notices.TryDequeue(out notice);
        }

        /// <summary>
        /// Send where the fingertip is; tell whether it went out. Numbers that are not finite are sent as a hand
        /// that is not seen.
        /// </summary>
        /// <param name="pose">The newest pose.</param>
        /// <param name="number">Rises with every pose that the headset gives: a repeated one is no motion.</param>
        public bool Send(HandPose pose, long number)
        {
            bool seen = pose.Valid && pose.PositionM.IsFinite;
            Point3 p = seen ? pose.PositionM : new Point3(0.0, 0.0, 0.0);
            lock (_sending)
            {
                string line = string.Format(
                    CultureInfo.InvariantCulture,
                    "{{\"type\":\"hand\",\"seq\":{0},\"t\":{1:F6},\"p\":[{2:F7},{3:F7},{4:F7}],\"clutch\":{5},\"valid\":{6},\"pose\":{7}}}\n",
                    _seq, NowS, p.X, p.Y, p.Z, Json(seen && pose.Clutch), Json(seen), number);
                if (_state != LinkState.InControl || !Write(line))
                {
                    return false;
                }
                _seq++;
                return true;
            }
        }

        private static string Json(bool value)
        {
            return value ? "true" : "false";
        }

        private void Run()
        {
            int pauseMs = FirstPauseMs;
            do
            {
                bool welcomed = false;
                try
                {
                    welcomed = Converse();
                }
                catch (Exception error) when (IsOfTheConnection(error))
                {
                    Tell("The server is not reached (" + error.Message + "): trying again.");
                }
                finally
                {
                    Hang();
                    _twin = null;
                    _session = null;
                }
                if (_state == LinkState.Ended)
                {
                    return;
                }
                _state = LinkState.Connecting;
                pauseMs = welcomed ? FirstPauseMs : Math.Min(2 * pauseMs, LongestPauseMs);
            }
            while (!_ending.WaitOne(pauseMs));
        }

        /// <summary>One connection from its hello to its end; returns whether the server welcomed it.</summary>
        private bool Converse()
        {
            var socket = new Socket(SocketType.Stream, ProtocolType.Tcp)
            {
                NoDelay = true,
                ReceiveTimeout = SilenceMs,
                SendTimeout = SilenceMs,
            };
            _socket = socket;
            socket.Connect(_host, _port);
            socket.Send(Encoding.UTF8.GetBytes(_hello));
            bool welcomed = false;
            using (var reader = new StreamReader(new NetworkStream(socket), new UTF8Encoding(false)))
            {
                string line;
                while (!_ending.WaitOne(0) && (line = reader.ReadLine()) != null)
                {
                    JObject message = JObject.Parse(line);
                    switch (message.Value<string>("type"))
                    {
                        case "welcome":
                            welcomed = true;
                            Seat(message, "Another hand has control: it must give it back first.");
                            _session = message.Value<string>("session");
                            break;
                        case "twin":
                            _twin = new Twin(message);
                            break;
                        case "lease":
                            Seat(message, message.Value<string>("message"));
                            break;
                        case "error":
                            Refused(message);
                            break;
                    }
                }
            }
            return welcomed;
        }

        private static bool IsOfTheConnection(Exception error)
        {
            return error is SocketException || error is IOException || error is ObjectDisposedException
                || error is JsonException;
        }

        private void Seat(JObject message, string otherwise)
        {
            bool mine = message.Value<bool>("lease");
            _reason = mine ? "" : otherwise;
            _state = mine ? LinkState.InControl : LinkState.Watching;
            _notices.Enqueue(mine ? "This hand has control." : otherwise);
        }

        private void Refused(JObject message)
        {
            Tell(message.Value<string>("message"));
            switch (message.Value<string>("code"))
            {
                // No new connection mends these.
                case "bad_token":
                case "forbidden":
                case "bad_version":
                case "bad_message":
                    _state = LinkState.Ended;
                    break;
            }
        }

        private void Tell(string reason)
        {
            if (reason != _reason)
            {
                _reason = reason;
                _notices.Enqueue(reason);
            }
        }

        /// <summary>Write a line with one call, so that it is one packet.</summary>
        private bool Write(string line)
        {
            Socket socket = _socket;
            try
            {
                // A server that does not read gets nothing more: later it would be stale.
                if (socket == null || !socket.Poll(0, SelectMode.SelectWrite))
                {
                    return false;
                }
                socket.Send(Encoding.UTF8.GetBytes(line));
                return true;
            }
            catch (Exception error) when (error is SocketException || error is ObjectDisposedException)
            {
                return false; // the reading thread finds out, tells it and connects anew
            }
        }

        private void Hang()
        {
            Socket socket = Interlocked.Exchange(ref _socket, null);
            if (socket != null)
            {
                socket.Dispose();
            }
        }
    }
}
