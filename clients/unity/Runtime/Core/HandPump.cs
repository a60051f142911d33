using System;
using System.Threading;

namespace MrNav
{
    /// <summary>
    /// Sends the newest pose 60 times a second from a thread of its own, so that a slow frame of the headset does
    /// not look like a lost hand. Poses that stop coming are not repeated for long: the rig then holds.
    /// </summary>
    public sealed class HandPump : IDisposable
    {
        private const double PeriodS = 1.0 / 60.0;
        private const double FreshS = 0.08;

        private readonly HandLink _link;
        private readonly Thread _thread;
        private readonly object _lock = new object();
        private HandPose _pose;
        private double _givenS = double.NegativeInfinity;
        private long _number;
        private long _sent;
        private volatile bool _ending;

        public HandPump(HandLink link)
        {
            _link = link;
            _thread = new Thread(Run) { IsBackground = true, Name = "mrnav hand" };
            _thread.Start();
        }

        /// <summary>How many messages went out.</summary>
        public long Sent
        {
            get { return Interlocked.Read(ref _sent); }
        }

        /// <summary>Give the newest pose; call it once for every pose that the headset has.</summary>
        public void Give(HandPose pose)
        {
            lock (_lock)
            {
                _pose = pose;
                _givenS = HandLink.NowS;
                _number++;
            }
        }

        /// <summary>Stop sending: the rig holds.</summary>
        public void Dispose()
        {
            _ending = true;
            _thread.Join();
        }

        private void Run()
        {
            double dueS = HandLink.NowS;
            while (!_ending)
            {
                SendNewest();
                double nowS = HandLink.NowS;
                // Deadlines do not drift; those that were missed are not made up for.
                dueS = Math.Max(dueS + PeriodS, nowS);
                int pauseMs = (int)Math.Round(1000.0 * (dueS - nowS));
                if (pauseMs > 0)
                {
                    Thread.Sleep(pauseMs);
                }
            }
        }

        private void SendNewest()
        {
            HandPose pose;
            long number;
            lock (_lock)
            {
                if (HandLink.NowS - _givenS > FreshS)
                {
                    return;
                }
                pose = _pose;
                number = _number;
            }
            if (_link.Send(pose, number))
            {
                Interlocked.Increment(ref _sent);
            }
        }
    }
}
